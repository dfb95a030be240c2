"""The figures of `./dev bench codec` and `./dev bench follower`: ours in turns with peers and with a plain memory pass."""

import statistics

from brokers_report import Report
from figures import ProgramFailed, Programs, number

OURS = ("reference", "compact", "lossless")
ENCODE_LIMIT_MS = {"reference": 0.6, "compact": 2, "lossless": 2}
DECODE_LIMIT_MS = {"reference": 0.5, "compact": 1, "lossless": 1}
RAW_PEER = "delta + zstd -1"
EVERY_FRAME_RATIO = 20  # the target for `compact` on real frames
# Published results that ours must reach: (our codec, source, compression ratio, encoding time in ms).
PUBLISHED = (("reference", "the paper", 10, 10), ("lossless", "Mehrotra 2011", 7, 5))


def by_name(lines, key):
    """{name: [a value for each round]} of the contestants that have this value."""
    values = {}
    for line in lines:
        if key in line:
            values.setdefault(line["name"], []).append(line[key])
    return values


def record(report, name, unit, value):
    """Adds a figure that is the same in every round to the JSON; table() prints it."""
    report.results.append({"name": name, "value": value, "unit": unit, "baseline": None, "baseline_value": None,
                           "ratio": None, "target": None, "met": None, "rounds": 1, "spread": 0.0})


def table(title, quality, encode, decode):
    print(f"\n{title + ': all of them':<28} {'ratio':>7} {'worst':>7} {'encode ms':>10} {'decode ms':>10} "
          f"{'max mm':>7} {'RMS mm':>7} {'lost %':>7}")
    for name, line in quality.items():
        print(f"{name:<28} {line['ratio']:>7.2f} {line['worst_ratio']:>7.2f} "
              f"{statistics.median(encode[name]):>10.3f} {statistics.median(decode[name]):>10.3f} "
              f"{line['max_error_mm']:>7.0f} {number(line['rms_error_mm']):>7} {number(line['lost_percent']):>7}")
    print()


def codec_figures(report, title, lines, real):
    encode, decode, steps = (by_name(lines, key) for key in ("encode_ms", "decode_ms", "ms"))
    quality = {line["name"]: line for line in lines if "ratio" in line}
    copy = steps["copy"]
    for name, line in quality.items():
        own = name in OURS
        report.compare(f"{title}: {name}, encode", "ms", encode[name], "copy", copy,
                       at_most=ENCODE_LIMIT_MS[name] if own else None)
        report.compare(f"{title}: {name}, decode", "ms", decode[name], "copy", copy,
                       at_most=DECODE_LIMIT_MS[name] if own else None)
    report.compare(f"{title}: inversion step", "ms", steps["inversion"], "copy", copy, at_most=0.12)
    report.compare(f"{title}: inversion step, portable", "ms", steps["inversion, portable"], "copy", copy)
    for name, line in quality.items():
        for figure, unit in (("max_error", "mm"), ("rms_error", "mm"), ("lost", "percent")):
            record(report, f"{title}: {name}, {figure.replace('_', ' ')}", unit, line[f"{figure}_{unit}"])
        if name not in ("compact", "lossless"):
            record(report, f"{title}: {name}, ratio", ":1", line["ratio"])

    def ratio(name):
        return [quality[name]["ratio"]]

    report.compare(f"{title}: compact, ratio", ":1", ratio("compact"), "reference", ratio("reference"), ratio_at_least=3)
    report.compare(f"{title}: lossless, ratio", ":1", ratio("lossless"), RAW_PEER, ratio(RAW_PEER), ratio_at_least=1.3)
    for codec, of, least, most_ms in PUBLISHED:
        report.compare(f"{title}: {codec}, ratio of {of}", ":1", ratio(codec), at_least=least)
        report.compare(f"{title}: {codec}, time of {of}", "ms", encode[codec], at_most=most_ms)
    if real:
        report.compare(f"{title}: compact, worst ratio", ":1", [quality["compact"]["worst_ratio"]],
                       at_least=EVERY_FRAME_RATIO)
    table(title, quality, encode, decode)


def follower_figures(report, title, lines, real):
    steps = by_name(lines, "ms")
    for suffix in ("", ", cached"):
        report.compare(f"{title}: follower{suffix}", "ms", steps[f"follower{suffix}"], "reading",
                       steps[f"reading{suffix}"], at_most=0.1)
    report.compare(f"{title}: follower, portable, cached", "ms", steps["follower, portable, cached"], "reading",
                   steps["reading, cached"])
    for codec in OURS:
        report.compare(f"{title}: the whole bolt, {codec}", "ms", steps[f"bolt, {codec}"], "reading", steps["reading"],
                       at_most=0.7 if codec == "reference" else None)


def run(given, program, figures):
    programs, report = Programs(given.build / "bin", "codec"), Report()
    if not programs.has(program):
        raise ProgramFailed(f"bench_codec_{program} is not built: liblz4-dev or libzstd-dev was missing when CMake ran")
    rounds = given.rounds or (3 if given.quick else 7)
    each = 5 if given.quick else 20
    report.print_head()
    figures(report, "simulator", programs.run(program, rounds, each), real=False)
    for folder in given.frames:
        figures(report, folder.name, programs.run(program, rounds, each, folder), real=True)
    return report, report.verdict()


def run_codec(given):
    return run(given, "frames", codec_figures)


def run_follower(given):
    return run(given, "follower", follower_figures)
