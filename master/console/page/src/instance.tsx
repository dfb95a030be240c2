// One instance: its record, its channels as they carry now, its history, its log.
import {useEffect, useRef, useState} from "preact/hooks";
import {call, get, type Plugin, Refused, type Row} from "./api";
import {nameOf, orderRows} from "./fleet";
import {known} from "./live";
import {confirm, Empty, isAdmin, mayAct, order, Panel, State, useKnown} from "./parts";
import {PagesOf} from "./robots";
import {age, bytes, count, short, time} from "./words";

interface Channel {
  name: string;
  transport: string;
  out: boolean;
  url: string;
  shared: boolean;
}
interface Driver extends Row {
  channelRecords: Channel[];
  plugin?: string;
  sha256?: string;
  signed_by?: string;
}
/** Of an order: discovery/records.h. */
interface Ordered {
  plugin: string;
  sha256?: string;
  manager?: string;
  properties: Record<string, string>;
}
interface Change {
  time_ms: number;
  state: string;
  reason: string;
}
interface Look {
  problem?: string;
  elapsed_us: number;
  count: number;
  bytes: number;
  smallest: number;
  largest: number;
  channels: {name: string; broker: string; broker_state: string; broker_problem?: string; waiting: number; oldest_ms: number;
              done?: number; lost?: Record<string, number>}[];
}

/** Asks again and again while the page shows it, the next time when the last answer is there. */
export function useRepeated(ask: () => Promise<void>, period: number, dependencies: unknown[], active = true): void {
  useEffect(() => {
    let ended = false, timer = 0;
    const next = async (): Promise<void> => {
      if (!document.hidden) await ask();
      if (!ended) timer = window.setTimeout(() => void next(), period);
    };
    if (active) void next();
    return () => { ended = true; clearTimeout(timer); };
  }, [...dependencies, active]);
}

const lookName = Math.random().toString(36).slice(2);

function Channels({driver}: {driver: Driver}) {
  const [seen, setSeen] = useState<Record<string, {rate: number; flow: number; look: Look}>>({});
  const former = useRef<Record<string, Look>>({});
  const [problem, setProblem] = useState("");
  useRepeated(async () => {
    for (const channel of driver.channelRecords.slice(0, 8)) {
      try {
        const look: Look = await call("look", {gateway: driver.gateway, instance: driver.instance, channel: channel.name, look: `page-${lookName}`, most: 0});
        if (look.problem) {
          setProblem(look.problem);
          continue;
        }
        setProblem("");
        const was = former.current[channel.name];
        former.current[channel.name] = look;
        const s = was && look.elapsed_us > was.elapsed_us ? (look.elapsed_us - was.elapsed_us) / 1e6 : 0;
        if (s) setSeen((all) => ({...all, [channel.name]: {look, rate: (look.count - was!.count) / s, flow: (look.bytes - was!.bytes) / s}}));
      } catch (error) {
        setProblem(error instanceof Refused ? error.message : "the master does not answer");
      }
    }
  }, 2000, [driver.gateway, driver.instance, driver.state], driver.state === "active");
  return (
    <Panel title="Channels">
      {problem && <p class="problem">{problem}</p>}
      {!driver.channelRecords.length ? <Empty>It has none.</Empty> : (
        <div class="scroll"><table>
          <thead><tr><th>Channel</th><th>Direction</th><th>Broker</th><th class="n">Messages/s</th><th class="n">Bytes/s</th><th class="n">Size</th>
            <th class="n">Waiting</th><th class="n">Confirmed, handled</th><th>Others since it was opened</th><th><span class="hidden">Acts</span></th></tr></thead>
          <tbody>
            {driver.channelRecords.map((channel) => {
              const one = seen[channel.name];
              const now = one?.look.channels.find((state) => state.name === channel.name);
              return (
                <tr key={channel.name}>
                  <td>{channel.name}{channel.shared ? <span class="quiet"> shared</span> : ""}</td>
                  <td>{channel.out ? "to the cloud" : "to the device"}</td>
                  <td title={channel.url}>{channel.transport} {now && now.broker_state !== "connected" && <b class="bad-text">{now.broker_state}: {now.broker_problem}</b>}</td>
                  <td class="n">{one ? count(one.rate) : "-"}</td>
                  <td class="n">{one ? bytes(one.flow) : "-"}</td>
                  <td class="n">{one?.look.largest ? `${bytes(one.look.smallest)} to ${bytes(one.look.largest)}` : "-"}</td>
                  <td class="n">{now ? `${now.waiting}${now.oldest_ms ? `, ${now.oldest_ms} ms` : ""}` : "-"}</td>
                  <td class="n">{now ? count(now.done ?? 0) : "-"}</td>
                  <td class="lost">{!now ? "-" : Object.entries(now.lost ?? {}).length === 0 ? <span class="quiet">none</span>
                    : Object.entries(now.lost ?? {}).map(([fate, number]) => <span key={fate} class="tag">{`${count(number)} ${fate}`}</span>)}</td>
                  <td><a href={`#/tap?${new URLSearchParams({gateway: driver.gateway, instance: driver.instance, channel: channel.name})}`}>Look</a>
                    {channel.out && <>{" "}<a href={`#/way?${new URLSearchParams({gateway: driver.gateway, instance: driver.instance, channel: channel.name})}`}>Its way</a></>}</td>
                </tr>
              );
            })}
          </tbody>
        </table></div>
      )}
    </Panel>
  );
}

function Log({driver}: {driver: Driver}) {
  const [text, setText] = useState("");
  const [follow, setFollow] = useState(true);
  const [problem, setProblem] = useState("");
  const position = useRef("");
  const box = useRef<HTMLPreElement>(null);
  useRepeated(async () => {
    try {
      const part = await call("log", {gateway: driver.gateway, instance: driver.instance, position: position.current});
      position.current = part.position;
      setProblem("");
      if (!part.text) return;
      setText((all) => (all + part.text).slice(-200_000));
    } catch (error) {
      setProblem(error instanceof Refused ? error.message : "the master does not answer");
    }
  }, 1000, [driver.gateway, driver.instance], follow);
  useEffect(() => {
    if (follow && box.current) box.current.scrollTop = box.current.scrollHeight;
  }, [text]);
  return (
    <Panel title="Log of its driver host" more={<label><input type="checkbox" checked={follow} onChange={(event) => setFollow(event.currentTarget.checked)} /> follow</label>}>
      {problem && <p class="problem">{problem}</p>}
      <pre class="log" ref={box} tabIndex={0} aria-label="Log">{text || "nothing yet"}</pre>
    </Panel>
  );
}

export function Instance({gateway, instance}: {gateway: string; instance: string}) {
  const {rows, rowsComplete, state} = useKnown();
  const [driver, setDriver] = useState<Driver | null>(null);
  const [changes, setChanges] = useState<Change[]>([]);
  const [ordered, setOrdered] = useState<Ordered | null>(null);
  const [problem, setProblem] = useState("");
  const row = rows.get(`${gateway}/${instance}`);
  useEffect(() => {
    let ended = false;
    void (async () => {
      try {
        const record = await get(`/api/instance?${new URLSearchParams({gateway, instance})}`);
        const history = await call("history", {instances: [instance], gateways: [gateway], most: 200});
        if (ended) return;
        setDriver({...record, driver: record.name, channelRecords: record.channels, channels: record.channels.length,
                   name: record.deployment ? `${record.deployment}/${record.index ?? 0}` : ""});
        setChanges(history.changes.reverse());
        setProblem(Object.entries(history.silent as Record<string, string>).map(([name, why]) => `${name}: ${why}`).join("; "));
        if (mayAct() && !record.made_by) setOrdered(await call("order_of", {gateway, instance}));
      } catch (error) {
        if (!ended) setProblem(error instanceof Refused ? error.message : "the master does not answer");
      }
    })();
    return () => { ended = true; };
  }, [gateway, instance, row?.state, row?.since_ms, known.me?.role]);
  if (rowsComplete && !row && !driver) return <Empty>There is no instance {instance} on {gateway}. <a href="#/fleet">To the fleet</a></Empty>;
  const shown = row ?? driver;
  if (!shown) return <Empty>{problem || "..."}</Empty>;
  const lost = state?.gateways.some((one) => one.gateway === gateway && !one.alive);
  return (
    <>
      <h1>{nameOf(shown)} <State of={shown.state} lost={lost} /></h1>
      {problem && <p class="problem" role="alert">{problem}</p>}
      <PagesOf driver={shown.driver} query={{gateway, instance}} />
      {mayAct() && (
        <div class="acts" role="group" aria-label="Acts">
          <button type="button" onClick={() => void orderRows("start", [shown])}>Start</button>
          <button type="button" onClick={() => void orderRows("stop", [shown])}>Stop</button>
          <button type="button" onClick={async () => {
            if (await confirm({title: `Restart ${nameOf(shown)}?`, act: "Restart", destroys: true, text: <p>Its driver is stopped and started anew.</p>}))
              void order(`Restart ${nameOf(shown)}`, "restart", {instances: [shown.instance], gateways: [shown.gateway]});
          }}>Restart</button>
          {isAdmin() && <button type="button" class="destroys" onClick={async () => {
            if (await orderRows("undeploy", [shown])) location.hash = "#/fleet";
          }}>Undeploy</button>}
        </div>
      )}
      <Panel title="Record">
        <dl class="facts">
          <dt>Instance</dt><dd><code>{instance}</code></dd>
          <dt>Driver</dt><dd>{shown.driver}</dd>
          <dt>Gateway</dt><dd>{gateway}</dd>
          <dt>Why</dt><dd>{shown.reason || "-"}</dd>
          <dt>Since</dt><dd>{time(shown.since_ms)} UTC, {age(shown.since_ms)}</dd>
          {(shown.made_by || ordered) && <><dt>Made by</dt><dd>{shown.made_by ? `${shown.made_by} of its gateway` : ordered!.manager ? `manifest ${ordered!.manager}` : "a person's order"}</dd></>}
          {driver && <><dt>Plugin</dt><dd>{driver.plugin || "-"} {driver.sha256 && <code title={driver.sha256}>{driver.sha256.slice(0, 12)}</code>}
            {driver.signed_by ? ` signed by ${driver.signed_by}` : ""}</dd></>}
          {Object.entries(shown.metadata).map(([key, value]) => <><dt>{key}</dt><dd>{value}</dd></>)}
        </dl>
        {ordered && Object.keys(ordered.properties).length > 0 && (
          <details><summary>Properties that it was deployed with</summary>
            <dl class="facts">{Object.entries(ordered.properties).map(([key, value]) => <><dt>{key}</dt><dd>{value}</dd></>)}</dl></details>
        )}
        {mayAct() && <Describe row={shown} />}
        {isAdmin() && ordered && <Update row={shown} ordered={ordered} />}
      </Panel>
      {driver && <Channels driver={{...driver, state: shown.state}} />}
      <Panel title="History" more={<a href={`#/history?instance=${encodeURIComponent(instance)}`}>All of it</a>}>
        {!changes.length ? <Empty>Its gateway remembers nothing.</Empty> : (
          <div class="scroll"><table>
            <thead><tr><th>Time (UTC)</th><th>State</th><th>Reason</th></tr></thead>
            <tbody>{changes.slice(0, 50).map((change) => (
              <tr key={`${change.time_ms} ${change.state}`}><td>{time(change.time_ms)}</td><td><State of={change.state} /></td><td>{change.reason}</td></tr>
            ))}</tbody>
          </table></div>
        )}
      </Panel>
      {driver && <Log driver={driver} />}
    </>
  );
}

const versionOf = (plugin: {sha256?: string; signed_version?: number; signed_by?: string}): string =>
  [plugin.sha256?.slice(0, 12), plugin.signed_version ? `version ${plugin.signed_version}` : "", plugin.signed_by ? `signed by ${plugin.signed_by}` : ""].filter(Boolean).join(", ");

const keyOf = (plugin: Plugin): string => `${plugin.file} ${plugin.sha256}`;

/** Gives the instance another plugin that its gateway has, another value of one property, or both: it is created anew, and goes
    back if it does not come up. */
function Update({row, ordered}: {row: Row; ordered: Ordered}) {
  const [key, setKey] = useState("");
  const [value, setValue] = useState("");
  const [plugins, setPlugins] = useState<Plugin[]>([]);
  const [problem, setProblem] = useState("");
  const [pick, setPick] = useState("");
  useEffect(() => {
    let ended = false;
    call("plugins", {gateways: [row.gateway]}).then((all) => {
      if (ended) return;
      const known: Plugin[] = all.plugins.map((one: {plugin: Plugin}) => one.plugin);
      // One that was sent is ordered by its checksum, one of the gateway's folder by its name.
      setPlugins(known.filter((one) => one.file && (one.file !== ordered.plugin || (one.sent ? one.sha256 !== ordered.sha256 : !!ordered.sha256))));
      setProblem(Object.values(all.silent as Record<string, string>).join("; "));
    }, (error) => { if (!ended) setProblem(error instanceof Refused ? error.message : "the master does not answer"); });
    return () => { ended = true; };
  }, [row.gateway, ordered]);
  const other = plugins.find((one) => keyOf(one) === pick);
  return (
    <form class="search" onSubmit={async (event) => {
      event.preventDefault();
      const next = {...ordered.properties};
      if (key && value) next[key] = value;
      else if (key) delete next[key];
      const words = [other && `${other.file} (${versionOf(other)})`, key && (value ? `${key}=${value}` : `no ${key}`)].filter(Boolean).join(" and ");
      if (await confirm({title: `Update ${nameOf(row)}?`, act: "Update", destroys: true,
                         text: <p>It is created anew with {words}. If it does not come up, it goes back.</p>}))
        await order(`Update ${nameOf(row)}`, "update", {
          selection: {instances: [row.instance], gateways: [row.gateway]}, plugin: other?.file ?? "",
          ...(other?.sent ? {sha256: other.sha256} : {}), properties: key ? [{instance: row.instance, properties: next}] : [],
        });
    }}>
      <label>Plugin <select value={pick} onChange={(event) => setPick(event.currentTarget.value)}>
        <option value="">{`as it is: ${ordered.plugin}`}</option>
        {plugins.map((one) => <option key={keyOf(one)} value={keyOf(one)} disabled={!!one.problem} title={one.problem}>{`${one.file} (${versionOf(one)})`}</option>)}</select></label>
      <label>Property <input required={!other} value={key} size={12} list="properties" onInput={(event) => {
        setKey(event.currentTarget.value);
        setValue(ordered.properties[event.currentTarget.value] ?? value);
      }} /></label>
      <datalist id="properties">{Object.keys(ordered.properties).map((name) => <option key={name} value={name} />)}</datalist>
      <label>Value <input value={value} size={16} placeholder="empty: remove" onInput={(event) => setValue(event.currentTarget.value)} /></label>
      <button type="submit">Update</button>
      {problem && <span class="quiet">{problem}</span>}
    </form>
  );
}

/** Changes one key of the metadata. */
function Describe({row}: {row: Row}) {
  const [key, setKey] = useState("");
  const [value, setValue] = useState("");
  return (
    <form class="search" onSubmit={async (event) => {
      event.preventDefault();
      const says = value ? `${key}=${value}` : `no ${key}`;
      if (await confirm({title: `Describe ${nameOf(row)}?`, act: "Describe", destroys: false, text: <p>Its metadata will say: {says}</p>}))
        await order(`Describe ${row.name || short(row.instance)}`, "updateMetadata", {instances: [row.instance], gateways: [row.gateway], changes: {[key]: value}});
    }}>
      <label>Key <input required value={key} size={12} onInput={(event) => setKey(event.currentTarget.value)} /></label>
      <label>Value <input value={value} size={16} placeholder="empty: remove" onInput={(event) => setValue(event.currentTarget.value)} /></label>
      <button type="submit">Describe</button>
    </form>
  );
}
