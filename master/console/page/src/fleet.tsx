// All instances: thousands of rows, of which only those in sight are drawn.
import {useEffect, useMemo, useRef, useState} from "preact/hooks";
import {get, type Row} from "./api";
import {placeOf, WorldMap} from "./map";
import {linkOf} from "./overview";
import {confirm, Empty, isAdmin, mayAct, order, State, useKnown} from "./parts";
import {age, csv, plural, save, short} from "./words";

const rowHeight = 34;
const collator = new Intl.Collator("en", {numeric: true});  // one for all: to make one takes longer than to compare
const beyond = 8;  // rows above and below what is in sight

type Column = "name" | "driver" | "gateway" | "state" | "since_ms" | "reason";
const columns: {key: Column; title: string}[] = [
  {key: "state", title: "State"}, {key: "name", title: "Name"}, {key: "driver", title: "Driver"},
  {key: "gateway", title: "Gateway"}, {key: "since_ms", title: "Since"}, {key: "reason", title: "Reason, metadata"},
];
const groups = ["none", "gateway", "driver", "state", "deployment", "made by"] as const;
type Group = (typeof groups)[number];
type Line = {group: string; number: number; row?: undefined} | {row: Row; group?: undefined; number?: undefined};

export const nameOf = (row: {name: string; instance: string}): string => row.name || short(row.instance);
const keyOf = (row: Row): string => `${row.gateway}/${row.instance}`;
const words = (row: Row): string =>
  [row.reason, row.made_by && `made by ${row.made_by}`, ...Object.entries(row.metadata).map(([key, value]) => `${key}=${value}`)].filter(Boolean).join(" · ");
const groupOf = (row: Row, by: Group): string =>
  by === "made by" ? row.made_by || "(an order)" : by === "deployment" ? row.name.replace(/\/\d+$/, "") || "(without a name)" : by === "none" ? "" : row[by];

function compare(a: Row, b: Row, by: Column): number {
  if (by === "since_ms") return b.since_ms - a.since_ms;
  const text = (row: Row): string => (by === "name" ? nameOf(row) : row[by]);
  return collator.compare(text(a), text(b));
}

/** What people are told before an order: how many, and which. */
export function Named({rows}: {rows: Row[]}) {
  return (
    <>
      <p>{plural(rows.length, "instance")} on {plural(new Set(rows.map((row) => row.gateway)).size, "gateway")}:</p>
      <ul class="named">
        {rows.slice(0, 12).map((row) => <li key={keyOf(row)}>{nameOf(row)} <span class="quiet">{row.driver} on {row.gateway}</span></li>)}
        {rows.length > 12 && <li>and {rows.length - 12} more</li>}
      </ul>
    </>
  );
}

export async function orderRows(verb: "start" | "stop" | "undeploy", rows: Row[]): Promise<boolean> {
  const word = verb[0]!.toUpperCase() + verb.slice(1);
  const yes = await confirm({
    title: `${word} ${rows.length === 1 ? nameOf(rows[0]!) : plural(rows.length, "instance")}?`,
    act: word, destroys: verb !== "start",
    type: verb === "undeploy" && rows.length > 1 ? String(rows.length) : undefined,
    text: <><Named rows={rows} />{verb === "undeploy" && <p>What their driver hosts keep of them goes with them.</p>}</>,
  });
  return yes && order(`${word} ${rows.length === 1 ? nameOf(rows[0]!) : plural(rows.length, "instance")}`, verb,
                      {instances: rows.map((row) => row.instance), gateways: [...new Set(rows.map((row) => row.gateway))]});
}

export function Fleet({where}: {where: string}) {
  const {rows, rowsComplete, state, rowsVersion, whereProblem} = useKnown();
  const [text, setText] = useState(where);
  const [problem, setProblem] = useState("");
  const wrong = problem || whereProblem;
  const [by, setBy] = useState<Column>("name");
  const [down, setDown] = useState(false);
  const [group, setGroup] = useState<Group>("none");
  const [chosen, setChosen] = useState(new Set<string>());
  const [top, setTop] = useState(0);
  const [tall, setTall] = useState(600);
  const [at, setAt] = useState(0);
  const [map, setMap] = useState(false);
  const box = useRef<HTMLDivElement>(null);
  useEffect(() => setText(where), [where]);
  useEffect(() => {
    const element = box.current!;
    const watch = new ResizeObserver(() => setTall(element.clientHeight));
    watch.observe(element);
    return () => watch.disconnect();
  }, []);
  const sorted = useMemo(() => {
    const all = [...rows.values()].sort((a, b) => compare(a, b, by) || (a.instance < b.instance ? -1 : 1));
    return down ? all.reverse() : all;
  }, [rowsVersion, by, down]);
  const lines = useMemo<Line[]>(() => {
    if (group === "none") return sorted.map((row) => ({row}));
    const parts = new Map<string, Row[]>();
    for (const row of sorted) {
      const name = groupOf(row, group);
      const part = parts.get(name);
      if (part) part.push(row);
      else parts.set(name, [row]);
    }
    return [...parts].sort(([a], [b]) => collator.compare(a, b))
      .flatMap(([name, part]) => [{group: name, number: part.length}, ...part.map((row) => ({row}))] as Line[]);
  }, [sorted, group]);
  const anyPlace = useMemo(() => sorted.some((row) => placeOf(row)), [sorted]);
  const lost = new Set(state?.gateways.filter((gateway) => !gateway.alive).map((gateway) => gateway.gateway));
  const first = Math.max(0, Math.floor(top / rowHeight) - beyond);
  const last = Math.min(lines.length, Math.ceil((top + tall) / rowHeight) + beyond);
  const picked = sorted.filter((row) => chosen.has(keyOf(row)));

  const search = async (event: Event): Promise<void> => {
    event.preventDefault();
    const expression = text.trim();
    try {
      if (expression) await get(`/api/live?check=1&where=${encodeURIComponent(expression)}`);
      setProblem("");
      setChosen(new Set());
      location.hash = expression ? `#/fleet?where=${encodeURIComponent(expression)}` : "#/fleet";
    } catch (error) {
      setProblem(error instanceof Error ? error.message : String(error));
    }
  };
  const choose = (row: Row): void => {
    const next = new Set(chosen);
    if (!next.delete(keyOf(row))) next.add(keyOf(row));
    setChosen(next);
  };
  const goTo = (index: number): void => {
    const next = Math.max(0, Math.min(lines.length - 1, index));
    setAt(next);
    const element = box.current!;
    if (next * rowHeight < element.scrollTop) element.scrollTop = next * rowHeight;
    if ((next + 1) * rowHeight > element.scrollTop + element.clientHeight) element.scrollTop = (next + 1) * rowHeight - element.clientHeight;
  };
  const onKey = (event: KeyboardEvent): void => {
    if ((event.target as Element).closest("button, input, a")) return;
    const page = Math.max(1, Math.floor(tall / rowHeight) - 1);
    const steps: Record<string, number> = {ArrowDown: at + 1, ArrowUp: at - 1, PageDown: at + page, PageUp: at - page, Home: 0, End: lines.length - 1};
    const row = lines[at]?.row;
    if (event.key in steps) goTo(steps[event.key]!);
    else if (event.key === "Enter" && row) location.hash = linkOf(row);
    else if (event.key === " " && row && mayAct()) choose(row);
    else return;
    event.preventDefault();
  };

  return (
    <div class="fleet">
      <h1>Fleet <span class="quiet" id="number">{rowsComplete ? plural(sorted.length, "instance") : "..."}</span></h1>
      <form class="search" role="search" onSubmit={search}>
        <label class="grow"><span class="hidden">Which instances</span>
          <input value={text} placeholder='all, or an expression: state == "failed" and contains(gateway, "lab")' spellcheck={false}
                 autocapitalize="off" aria-invalid={!!wrong} aria-describedby="search-problem" onInput={(event) => setText(event.currentTarget.value)} />
        </label>
        <button type="submit">Show</button>
        <label>Group <select value={group} onChange={(event) => setGroup(event.currentTarget.value as Group)}>
          {groups.map((one) => <option key={one}>{one}</option>)}</select></label>
        {anyPlace && <button type="button" aria-pressed={map} onClick={() => setMap(!map)}>Map</button>}
        <button type="button" onClick={() => save("fleet.csv", "text/csv", csv(
          ["instance", "name", "driver", "gateway", "state", "reason", "since_ms", "made_by", "metadata"], sorted as unknown as Record<string, unknown>[]))}>CSV</button>
      </form>
      {wrong && <pre class="problem" id="search-problem" role="alert">{wrong}</pre>}
      {map && anyPlace && <WorldMap rows={sorted} lost={lost} chosen={chosen} onChoose={mayAct() ? (keys) => setChosen(new Set(keys)) : null} />}
      {mayAct() && (
        <div class="acts" aria-label="Acts on chosen instances" role="group">
          <button type="button" onClick={() => setChosen(picked.length === sorted.length ? new Set() : new Set(sorted.map(keyOf)))}
                  disabled={!sorted.length}>{picked.length && picked.length === sorted.length ? "Choose none" : `Choose all ${sorted.length}`}</button>
          <span class="quiet">{plural(picked.length, "instance")} chosen</span>
          <button type="button" disabled={!picked.length} onClick={() => void orderRows("start", picked)}>Start</button>
          <button type="button" disabled={!picked.length} onClick={() => void orderRows("stop", picked)}>Stop</button>
          {isAdmin() && <button type="button" class="destroys" disabled={!picked.length}
                                onClick={async () => { if (await orderRows("undeploy", picked)) setChosen(new Set()); }}>Undeploy</button>}
        </div>
      )}
      <div class="grid" role="grid" tabIndex={0} aria-activedescendant={lines.length ? `line-${at}` : undefined} onKeyDown={onKey}
           aria-label="Driver instances; arrow keys move, Enter opens, the space bar chooses" aria-rowcount={lines.length + 1} aria-colcount={columns.length}>
        <div role="rowgroup"><div class="line head" role="row" aria-rowindex={1}>
          {columns.map(({key, title}) => (
            <span key={key} role="columnheader" class={`c-${key}`} aria-sort={by === key ? (down ? "descending" : "ascending") : "none"}>
              <button type="button" onClick={() => { setDown(by === key && !down); setBy(key); }}>{title}{by === key ? (down ? " ▾" : " ▴") : ""}</button>
            </span>
          ))}
        </div></div>
        <div class="rows" role="rowgroup" ref={box} tabIndex={-1} onScroll={(event) => setTop(event.currentTarget.scrollTop)}>
          <div class="tall" style={{height: `${lines.length * rowHeight}px`}} role="presentation">
            {lines.slice(first, last).map((line, offset) => {
              const index = first + offset;
              const style = {transform: `translateY(${index * rowHeight}px)`};
              if (!line.row) {
                return <div key={`group ${line.group}`} id={`line-${index}`} role="row" aria-rowindex={index + 2}
                            class={index === at ? "line group at" : "line group"} style={style}>
                  <span role="gridcell" aria-colspan={columns.length}>{line.group} <span class="quiet">{line.number}</span></span></div>;
              }
              const row = line.row;
              const is = chosen.has(keyOf(row));
              return (
                <div key={keyOf(row)} id={`line-${index}`} role="row" aria-rowindex={index + 2} aria-selected={is} style={style}
                     class={`line${is ? " chosen" : ""}${index === at ? " at" : ""}`} onClick={() => setAt(index)}>
                  <span role="gridcell" class="c-state">
                    {mayAct() && <input type="checkbox" tabIndex={-1} checked={is} aria-label={`Choose ${nameOf(row)}`} onChange={() => choose(row)} />}
                    <State of={row.state} lost={lost.has(row.gateway)} />
                  </span>
                  <span role="gridcell" class="c-name"><a tabIndex={-1} href={linkOf(row)} title={row.instance}>{nameOf(row)}</a></span>
                  <span role="gridcell" class="c-driver">{row.driver}</span>
                  <span role="gridcell" class="c-gateway">{row.gateway}</span>
                  <span role="gridcell" class="c-since_ms">{age(row.since_ms)}</span>
                  <span role="gridcell" class="c-reason" title={words(row)}>{words(row)}</span>
                </div>
              );
            })}
          </div>
          {rowsComplete && !lines.length && <Empty>{where ? "No instance is like that." : "Nothing is deployed. Try: iotcloud deploy loadgen.so"}</Empty>}
        </div>
      </div>
    </div>
  );
}
