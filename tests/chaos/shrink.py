"""Makes a schedule that shows a violation smaller (delta debugging): parts of it are left out as long as what remains
shows one."""


def shrink(actions, fails, budget, keep=lambda actions, runs: None):
    """A part of `actions` for which `fails(part)` is true; `actions` itself when no smaller one was found.

    `fails` runs the cluster, so it is called at most `budget` times. Because a run is partly chance, a part that did not
    fail once may be one that fails seldom: the result is small, not the smallest. `keep(part, runs)` is called with each
    smaller part that failed."""
    actions, runs, pieces = list(actions), 0, 2
    while len(actions) > 1:
        for candidate in candidates(actions, pieces):
            if runs == budget:
                return actions
            runs += 1
            if fails(candidate):
                actions, pieces = candidate, max(2, min(pieces - 1, len(candidate)))
                keep(actions, runs)
                break
        else:
            if pieces >= len(actions):
                break
            pieces = min(2 * pieces, len(actions))
    return actions


def candidates(actions, pieces):
    """The halves, or all but one of more pieces."""
    size = -(-len(actions) // pieces)
    begins = range(0, len(actions), size)
    if pieces == 2:
        return [actions[at:at + size] for at in begins]
    return [actions[:at] + actions[at + size:] for at in begins]
