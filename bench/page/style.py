"""Colours: those of the page, and those that every picture carries with it."""

# Each colour twice: for a light and for a dark background.
PALETTE = (("#1f6fb2", "#6cb2f0"), ("#c8501e", "#f08c5a"), ("#2b8a3e", "#69c97a"), ("#8e44ad", "#c792ea"),
           ("#9a7200", "#e0b84a"), ("#0e8080", "#4fd0d0"), ("#c2255c", "#f06595"), ("#606060", "#b0b0b0"))

BAD = ("#c0182b", "#ff7b72")

# The colours of what gnuplot draws without a colour of its own.
_GROUND, _INK, _GRID = ("#ffffff", "#15181c"), ("black", "#d8dce2"), ("gray", "#3a3f46")

# gnuplot writes colours as attributes; a style overrides them.
_DARK = "".join(f'.plot [{attribute}="{light}" i]{{{attribute}:{dark}}}'
                for light, dark in (*PALETTE, BAD, _GROUND, _INK, _GRID) for attribute in ("stroke", "fill", "color"))
PICTURE = (f".plot .ground{{fill:{_GROUND[0]}}}"
           f"@media (prefers-color-scheme:dark){{.plot .ground{{fill:{_GROUND[1]}}}{_DARK}}}")

PAGE = """
:root{--ground:#fff;--ink:#22262b;--soft:#5d6570;--edge:#d5d9de;--bad:#c0182b;--good:#1d7a35;--link:#1f5fa8}
@media (prefers-color-scheme:dark){
:root{--ground:#15181c;--ink:#d8dce2;--soft:#9aa3ae;--edge:#3a3f46;--bad:#ff7b72;--good:#69c97a;--link:#7db7f5}}
*{box-sizing:border-box}
body{margin:0 auto;padding:1rem;max-width:76rem;background:var(--ground);color:var(--ink);
font:16px/1.5 system-ui,sans-serif;overflow-wrap:break-word}
h1{font-size:1.6rem}h2{margin-top:2.5rem;border-bottom:1px solid var(--edge)}
a{color:var(--link)}.soft{color:var(--soft)}.missed{color:var(--bad);font-weight:600}.met{color:var(--good)}
.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,26rem),1fr));gap:1rem}
figure{margin:0;min-width:0;max-width:46rem}figure svg{width:100%;height:auto;display:block}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.87rem;font-variant-numeric:tabular-nums}
th,td{padding:.2rem .6rem;border-bottom:1px solid var(--edge);text-align:right;vertical-align:top}
td{white-space:nowrap}th:first-child,td.name,td.cause{text-align:left;white-space:normal}
td:first-child{min-width:9rem}td.cause{min-width:20rem}
summary{cursor:pointer;padding:.3rem 0}code{font-size:.9em}
nav li{margin:.15rem 0}
"""
