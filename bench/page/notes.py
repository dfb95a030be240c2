"""Notes below a picture: failed points, and the sources of values."""

from .markup import number


def failed_notes(plot):
    return [f"{series['name']}, at {number(point.get('x'))}: FAILED: {point['failed']}"
            for series in plot["series"] for point in series["points"] if "failed" in point]


def source_notes(plot):
    """A note for each source that values of the paper come from."""
    notes = []
    for series in plot["series"]:
        values = {}
        for point in series["points"]:
            if point.get("source"):
                said = ", ".join(f"{key.removesuffix('_ms').replace('_', ' ')} {number(value)} ms"
                                 for key, value in point.items() if key.endswith("_ms"))
                values.setdefault(point["source"], []).append(said)
        notes += [f"{series['name']}: {'; '.join(said)} ({source})" for source, said in values.items()]
    return notes
