"""Colours and shapes: those of the page, and those that every plot carries with it."""

# For a light and for a dark ground.
PALETTE = (("#1f6fb2", "#6cb2f0"), ("#c8501e", "#f08c5a"), ("#2b8a3e", "#69c97a"), ("#8e44ad", "#c792ea"),
           ("#9a7200", "#e0b84a"), ("#0e8080", "#4fd0d0"), ("#c2255c", "#f06595"), ("#606060", "#b0b0b0"))


def _colours(dark):
    ground, ink, grid, bad = ("#15181c", "#d8dce2", "#3a3f46", "#ff7b72") if dark else (
        "#ffffff", "#22262b", "#d5d9de", "#c0182b")
    rules = [f".plot .ground{{fill:{ground}}}", f".plot text{{fill:{ink}}}", f".plot .grid{{stroke:{grid}}}",
             f".plot .axis{{stroke:{ink}}}", f".plot .bad{{stroke:{bad}}}", f".plot .hollow{{fill:{ground}}}"]
    for index, pair in enumerate(PALETTE):
        rules += [f".plot .s{index}{{stroke:{pair[dark]}}}", f".plot .f{index}{{fill:{pair[dark]}}}"]
    return "".join(rules)


PLOT = (
    ".plot text{font:13px system-ui,sans-serif}.plot .title{font-weight:600;font-size:15px}"
    ".plot .grid,.plot .axis{stroke-width:1}.plot .line{fill:none;stroke-width:2}"
    ".plot .limit{stroke-dasharray:6 4}.plot .peer{stroke-dasharray:2 3}.plot .mark{stroke-width:2}"
    ".plot .bad{stroke-width:2.5;fill:none}"
    f"{_colours(False)}@media (prefers-color-scheme:dark){{{_colours(True)}}}"
)

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
