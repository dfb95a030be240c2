// What changed its state, and who did what.
import {useEffect, useState} from "preact/hooks";
import {call, get, Refused} from "./api";
import {Empty, mayAct, Panel, State, useKnown} from "./parts";
import {csv, plural, save, short, time} from "./words";

type Entry = Record<string, unknown>;

const changeColumns = ["time_ms", "gateway", "instance", "name", "driver", "state", "reason"];
const auditColumns = ["number", "time", "event", "who", "role", "certificate", "address", "order", "what", "outcome"];
const shownAtOnce = 500;

function Export({name, columns, rows}: {name: string; columns: string[]; rows: Entry[]}) {
  return (
    <>
      <button type="button" disabled={!rows.length} onClick={() => save(`${name}.csv`, "text/csv", csv(columns, rows))}>CSV</button>
      <button type="button" disabled={!rows.length} onClick={() => save(`${name}.json`, "application/json", JSON.stringify(rows, null, 1))}>JSON</button>
    </>
  );
}

export function History({query}: {query: URLSearchParams}) {
  const [text, setText] = useState(query.get("instance") ?? "");
  const [from, setFrom] = useState("");
  const [until, setUntil] = useState("");
  const {rows} = useKnown();
  const [changes, setChanges] = useState<Entry[] | null>(null);
  const [audit, setAudit] = useState<Entry[] | null>(null);
  const [problem, setProblem] = useState("");
  const [auditProblem, setAuditProblem] = useState("");
  const [again, setAgain] = useState(0);
  useEffect(() => setText(query.get("instance") ?? ""), [query.toString()]);
  useEffect(() => {
    const why = (error: unknown): string => (error instanceof Refused ? error.message : "the master does not answer");
    call("history", {most: 10_000}).then((history) => {
      setChanges(history.changes.reverse());
      setProblem(Object.entries(history.silent as Record<string, string>).map(([name, reason]) => `${name}: ${reason}`).join("; "));
    }, (error) => { setChanges([]); setProblem(why(error)); });
    if (!mayAct()) return;
    get("/api/audit").then((read) => { setAudit(read.lines.reverse()); setAuditProblem(read.more ? "Older lines are in the file." : ""); },
                           (error) => { setAudit([]); setAuditProblem(why(error)); });
  }, [again]);
  const since = from ? new Date(`${from}:00Z`).getTime() : 0;
  const before = until ? new Date(`${until}:00Z`).getTime() + 60_000 : Infinity;
  const fits = (entry: Entry, ms: number): boolean =>
    ms >= since && ms < before && (!text || Object.values(entry).some((value) => String(value).toLowerCase().includes(text.toLowerCase())));
  // What was undeployed has no name any more.
  const named = (changes ?? []).map((entry): Entry => ({...entry, name: rows.get(`${entry["gateway"]}/${entry["instance"]}`)?.name ?? ""}));
  const shown = named.filter((entry) => fits(entry, Number(entry["time_ms"])));
  const written = (audit ?? []).filter((entry) => fits(entry, Date.parse(String(entry["time"]))));
  return (
    <>
      <h1>History</h1>
      <form class="search" role="search" onSubmit={(event) => event.preventDefault()}>
        <label class="grow"><span class="hidden">Only with this text</span>
          <input value={text} placeholder="an instance, its name, a gateway, a state, a person ..." spellcheck={false} onInput={(event) => setText(event.currentTarget.value)} /></label>
        <label>From (UTC) <input type="datetime-local" value={from} onInput={(event) => setFrom(event.currentTarget.value)} /></label>
        <label>Until <input type="datetime-local" value={until} onInput={(event) => setUntil(event.currentTarget.value)} /></label>
        <button type="button" onClick={() => setAgain(again + 1)}>Ask again</button>
      </form>
      <Panel title="Changes of state" more={<><span class="quiet">{plural(shown.length, "change")}</span><Export name="history" columns={changeColumns} rows={shown} /></>}>
        {problem && <p class="problem" role="alert">{problem}</p>}
        {!changes ? <Empty>The master asks the gateways ...</Empty> : !shown.length ? <Empty>None.</Empty> : (
          <div class="scroll tall-scroll" tabIndex={0} role="region" aria-label="Changes of state"><table>
            <thead><tr><th>Time (UTC)</th><th>State</th><th>Instance</th><th>Driver</th><th>Gateway</th><th>Reason</th></tr></thead>
            <tbody>{shown.slice(0, shownAtOnce).map((entry, index) => (
              <tr key={index}><td>{time(Number(entry["time_ms"]))}</td><td><State of={String(entry["state"])} /></td>
                <td><a href={`#/instance/${encodeURIComponent(String(entry["gateway"]))}/${encodeURIComponent(String(entry["instance"]))}`}>{String(entry["name"]) || short(String(entry["instance"]))}</a></td>
                <td>{String(entry["driver"])}</td><td>{String(entry["gateway"])}</td><td>{String(entry["reason"])}</td></tr>))}</tbody>
          </table>{shown.length > shownAtOnce && <Empty>{shown.length - shownAtOnce} older ones are in the files that you save.</Empty>}</div>
        )}
      </Panel>
      {mayAct() && (
        <Panel title="Who did what" more={<><span class="quiet">{plural(written.length, "line")}</span><Export name="audit" columns={auditColumns} rows={written} /></>}>
          {auditProblem && <p class="problem">{auditProblem}</p>}
          {!audit ? <Empty>...</Empty> : !written.length ? <Empty>Nothing.</Empty> : (
            <div class="scroll tall-scroll" tabIndex={0} role="region" aria-label="Who did what"><table>
              <thead><tr><th>Time</th><th>Who</th><th>Role</th><th>From</th><th>Order</th><th>What</th><th>Outcome</th></tr></thead>
              <tbody>{written.slice(0, shownAtOnce).map((entry, index) => (
                <tr key={index} class={entry["event"] === "refused" ? "refused" : ""}><td>{String(entry["time"] ?? "")}</td><td>{String(entry["who"] ?? "")}</td><td>{String(entry["role"] ?? "")}</td>
                  <td>{String(entry["address"] ?? "")}</td><td>{String(entry["order"] ?? "")}{entry["event"] === "begun" ? " (begun)" : ""}</td><td>{String(entry["what"] ?? "")}</td>
                  <td>{String(entry["outcome"] ?? "")}</td></tr>))}</tbody>
            </table></div>
          )}
        </Panel>
      )}
    </>
  );
}
