// One message's way: where the time of a driver's last messages went.
import {useEffect, useMemo, useRef, useState} from "preact/hooks";
import {call, get, Refused} from "./api";
import {nameOf} from "./fleet";
import {useRepeated} from "./instance";
import {Empty, Panel, useKnown} from "./parts";
import {type Kind, type Look, type Outgoing, quantile, summary, traceFile, type TracePage, type Way, Ways} from "./ways";
import {bytes, count, duration, plural, save, short, time} from "./words";

const askName = `way-${Math.random().toString(36).slice(2)}`;
const periods: [number, string][] = [[1, "each message, as far as they fit"], [50, "20 a second"], [200, "5 a second"], [1000, "1 a second"]];
/** What the page asks at most, so that a large fleet is not asked for one driver. */
const mostChannels = 8, mostWorkers = 24;
const kinds: [Kind, string][] = [["driver", "driver"], ["broker", "broker"], ["wait", "waits"], ["work", "works"], ["confirm", "confirmed or acked"]];

interface Channel {
  name: string;
  out: boolean;
  properties?: Record<string, string>;
}

const endingsOf = (channel: Channel): string[] =>
  ["routingKey", "queueName", "topic"].map((key) => channel.properties?.[key] ?? "").filter(Boolean);

function Bars({way, from, long}: {way: Way; from: number; long: number}) {
  const lanes = [...new Set(way.parts.map((part) => `${part.where}\n${part.lane}`))];
  const high = 22;  // as .lanes span
  return (
    <div class="scroll lanes" tabIndex={0} role="group" aria-label="Its parts as bars">
      <div>{lanes.map((lane) => <span key={lane} title={lane.split("\n")[0]}>{lane.split("\n")[1]}</span>)}</div>
      <svg class="way" width="100%" height={lanes.length * high} viewBox={`0 0 1000 ${lanes.length * high}`} preserveAspectRatio="none"
         role="img" aria-label={way.parts.map((part) => `${part.name} ${duration(part.end_us - part.begin_us)}`).join(", ")}>
      {way.parts.map((part, index) => (
        <rect key={index} class={`part-${part.kind}${part.apart ? " apart" : ""}`} x={((part.begin_us - from) / long) * 1000}
              y={lanes.indexOf(`${part.where}\n${part.lane}`) * high + 3} height={high - 6}
              width={Math.max(1.5, (Math.max(0, part.end_us - part.begin_us) / long) * 1000)}>
          <title>{`${part.name} (${part.where}): ${duration(part.end_us - part.begin_us)}${part.apart ? ", the difference of two machines' clocks" : ""}`}</title>
        </rect>
      ))}
    </svg></div>
  );
}

function OneWay({way}: {way: Way}) {
  const from = Math.min(way.begin_us, ...way.parts.map((part) => part.begin_us));
  const long = Math.max(1, Math.max(...way.parts.map((part) => part.end_us)) - from);
  const parts = [...way.parts].sort((a, b) => a.begin_us - b.begin_us);
  return (
    <Panel title={`The message of ${time(way.time_ms)} on ${way.channel}`}>
      <div class="inside"><Bars way={way} from={from} long={long} /></div>
      {way.notes.map((note) => <p key={note} class="note">{note}</p>)}
      <div class="scroll" tabIndex={0} role="group" aria-label="Its parts"><table>
        <thead><tr><th>Part</th><th>Where</th><th>Task or channel</th><th class="n">Begins after</th><th class="n">Takes</th><th>Clock</th></tr></thead>
        <tbody>{parts.map((part, index) => (
          <tr key={index}><td><i class={`swatch part-${part.kind}`} aria-hidden="true" /> {part.name}</td><td>{part.where}</td><td>{part.lane}</td>
            <td class="n">{part.begin_us < way.begin_us ? `-${duration(way.begin_us - part.begin_us)}` : duration(part.begin_us - way.begin_us)}</td>
            <td class="n">{part.end_us < part.begin_us ? `-${duration(part.begin_us - part.end_us)}` : duration(part.end_us - part.begin_us)}</td>
            <td>{part.apart ? "difference of two machines' clocks" : "one"}</td></tr>))}</tbody>
      </table></div>
    </Panel>
  );
}

function Follow({gateway, instance, only}: {gateway: string; instance: string; only: string}) {
  const {state} = useKnown();
  const [channels, setChannels] = useState<Channel[] | null>(null);
  const [every, setEvery] = useState(200);
  const [paused, setPaused] = useState(false);
  const stands = useRef(false);  // as `paused`, for answers that were under way
  const pause = (on: boolean): void => {
    stands.current = on;
    setPaused(on);
  };
  const [list, setList] = useState<Way[]>([]);
  const [chosen, setChosen] = useState("");
  const [problems, setProblems] = useState<string[]>([]);
  const ways = useRef<Ways | null>(null);
  useEffect(() => {
    let ended = false;
    setChannels(null);
    get(`/api/instance?${new URLSearchParams({gateway, instance})}`).then(
      (record) => { if (!ended) setChannels(record.channels); },
      (error) => { if (!ended) { setChannels([]); setProblems([error instanceof Refused ? error.message : "the master does not answer"]); } });
    return () => { ended = true; };
  }, [gateway, instance]);
  const out = (channels ?? []).filter((one) => one.out && (!only || one.name === only)).slice(0, mostChannels);
  const back = (channels ?? []).filter((one) => !one.out).slice(0, mostChannels);
  const workers = (state?.topologies ?? []).flatMap((one) => one.workers.map((worker) => ({topology: one.name, worker: worker.name}))).slice(0, mostWorkers);
  const names = workers.map((one) => one.worker).join();
  useEffect(() => {
    const all: Outgoing[] = (channels ?? []).filter((one) => one.out).map((one) => ({name: one.name, endings: endingsOf(one)}));
    ways.current = channels ? new Ways(`driver host of ${gateway}`, all) : null;
    setList([]);
  }, [channels, only]);
  const lookAt = (channel: string, more: object = {}): Promise<Look> =>
    call("look", {gateway, instance, channel, look: askName, most: 64, bytes: 0, every_ms: every, ...more});
  const askWorker = (one: {topology: string; worker: string}, more: Record<string, string>): Promise<TracePage> =>
    call("worker", {...one, target: `/trace?${new URLSearchParams({id: askName, driver: instance, every_ms: String(every), ...more}).toString().replaceAll("+", "%20")}`});
  useRepeated(async () => {
    const now = ways.current;
    if (!now) return;
    const wrong: string[] = [];
    const one = async <T,>(ask: Promise<T>, take: (answer: T) => void, of: string): Promise<void> => {
      try {
        take(await ask);
      } catch (error) {
        wrong.push(`${of}: ${error instanceof Refused ? error.message : "the master does not answer"}`);
      }
    };
    const look = (channel: Channel, take: (answer: Look) => void): Promise<void> =>
      one(lookAt(channel.name), (answer) => { if (answer.problem) wrong.push(answer.problem); else take(answer); }, channel.name);
    // The workers first: a message that they miss because they were asked later would have a gap.
    await Promise.all(workers.map((worker) => one(askWorker(worker, {}), (page) => now.addWorker(page), worker.worker)));
    await Promise.all([...out.map((channel) => look(channel, (answer) => now.addOutgoing(channel.name, answer))),
                       ...back.map((channel) => look(channel, (answer) => now.addIncoming(channel.name, answer)))]);
    setProblems([...new Set(wrong)]);
    if (now === ways.current && !stands.current) setList(now.list());
  }, 1000, [gateway, instance, channels, only, every, names], !paused && !!channels);
  useEffect(() => () => {
    for (const channel of [...out, ...back]) void lookAt(channel.name, {last: true}).catch(() => undefined);
    for (const worker of workers) void askWorker(worker, {end: "1"}).catch(() => undefined);
  }, [gateway, instance, channels, only]);
  const parts = useMemo(() => summary(list), [list]);
  const totals = list.filter((way) => way.returned).map((way) => way.end_us - way.begin_us).sort((a, b) => a - b);
  const longest = Math.max(1, ...parts.map((part) => quantile(part.times, 0.5)));
  const shown = list.find((way) => way.key === chosen) ?? list[0];
  return (
    <>
      <div class="acts">
        <label>Follow <select value={every} onChange={(event) => setEvery(Number(event.currentTarget.value))}>
          {periods.map(([ms, text]) => <option key={ms} value={ms}>{text}</option>)}</select></label>
        <button type="button" aria-pressed={paused} onClick={() => pause(!paused)}>{paused ? "Go on" : "Pause"}</button>
        <button type="button" disabled={!list.length} onClick={() => save(`${instance}.trace.json`, "application/json",
          traceFile(list, {gateway, instance, from: "the console of IoTCloud"}))}>Save as a trace for Perfetto</button>
        <span class="quiet">{plural(list.length, "message")}{totals.length ? `; from publish to the driver's answer: half within ${duration(quantile(totals, 0.5))}, 99 % within ${duration(quantile(totals, 0.99))}` : ""}</span>
      </div>
      {problems.map((problem) => <p key={problem} class="problem" role="alert">{problem}</p>)}
      {channels && !out.length && !problems.length && <Empty>This instance sends on no channel, so there is no way to follow.</Empty>}
      {!list.length ? (channels ? out.length > 0 && <Empty>No message has passed yet.</Empty> : <Empty>...</Empty>) : (
        <>
          <Panel title="Where the time goes" more={<span class="legend quiet">{kinds.map(([kind, text]) => <span key={kind}><i class={`swatch part-${kind}`} /> {text} </span>)}</span>}>
            <div class="scroll" tabIndex={0} role="group" aria-label="Parts of all messages"><table>
              <thead><tr><th>Part</th><th class="n">Messages</th><th class="n">Half within</th><th class="n">99 % within</th><th class="n">Longest</th><th>Half within, as a bar</th></tr></thead>
              <tbody>{parts.map((part) => (
                <tr key={part.name}><td><i class={`swatch part-${part.kind}`} aria-hidden="true" /> {part.name}{part.apart && <b class="warm-text"> difference of two machines' clocks</b>}</td>
                  <td class="n">{count(part.times.length)}</td><td class="n">{duration(Math.max(0, quantile(part.times, 0.5)))}</td>
                  <td class="n">{duration(Math.max(0, quantile(part.times, 0.99)))}</td><td class="n">{duration(Math.max(0, quantile(part.times, 1)))}</td>
                  <td><svg class="share" width="100%" height="12" viewBox="0 0 100 12" preserveAspectRatio="none" aria-hidden="true">
                    <rect class={`part-${part.kind}`} width={Math.max(0.5, (100 * Math.max(0, quantile(part.times, 0.5))) / longest)} height="12" /></svg></td></tr>))}</tbody>
            </table></div>
          </Panel>
          {shown && <OneWay way={shown} />}
          <Panel title="Last messages">
            <div class="scroll tall-scroll" tabIndex={0} role="group" aria-label="Last messages"><table>
              <thead><tr><th>Time (UTC)</th><th>Channel</th><th class="n">Size</th><th class="n">Took</th><th>Came back</th><th>Notes</th></tr></thead>
              <tbody>{list.map((way) => (
                <tr key={way.key} class={way.key === shown?.key ? "chosen" : ""}>
                  <td><button type="button" class="link" aria-pressed={way.key === shown?.key} onClick={() => setChosen(way.key)}>{new Date(way.time_ms).toISOString().slice(11, 23)}</button></td>
                  <td>{way.channel}</td><td class="n">{bytes(way.size)}</td><td class="n">{duration(way.end_us - way.begin_us)}</td>
                  <td>{way.returned ? "yes" : "no answer seen"}</td><td>{way.notes.join("; ")}</td></tr>))}</tbody>
            </table></div>
          </Panel>
        </>
      )}
    </>
  );
}

export function MessageWay({query}: {query: URLSearchParams}) {
  const {rows} = useKnown();
  const [gateway, instance, channel] = ["gateway", "instance", "channel"].map((key) => query.get(key) ?? "") as [string, string, string];
  const all = [...rows].slice(0, 1000);
  const key = instance ? `${gateway}/${instance}` : "";
  return (
    <>
      <h1>One message's way</h1>
      <div class="search">
        <label>Instance <select value={key} onChange={(event) => {
          const row = rows.get(event.currentTarget.value);
          if (row) location.hash = `#/way?${new URLSearchParams({gateway: row.gateway, instance: row.instance})}`;
        }}>
          <option value="">choose ...</option>
          {key && !all.some(([one]) => one === key) && <option value={key}>{short(instance)}</option>}
          {all.map(([one, row]) => <option key={one} value={one}>{nameOf(row)} ({row.driver}, {row.gateway})</option>)}</select></label>
        {channel && <span>channel <b>{channel}</b> <a href={`#/way?${new URLSearchParams({gateway, instance})}`}>all channels</a></span>}
      </div>
      {instance ? <Follow key={`${key} ${channel}`} gateway={gateway} instance={instance} only={channel} />
        : <Empty>Choose an instance: of its last messages you see where the time went, from the driver through the broker and each bolt
          and back. Nothing is written down before, and nothing after you leave.</Empty>}
    </>
  );
}
