// What passes through a channel or a component now: a sample, and nothing when nobody looks.
import {useEffect, useRef, useState} from "preact/hooks";
import {call, get, Refused} from "./api";
import {Depth, looksLikeDepth} from "./depth-picture";
import {nameOf} from "./fleet";
import {useRepeated} from "./instance";
import {Empty, Panel, useKnown} from "./parts";
import {bytes, count, time} from "./words";

const kept = 100, keptPictures = 12;
const lookName = `tap-${Math.random().toString(36).slice(2)}`;
const pictureKinds: [string, number[]][] = [["image/png", [0x89, 0x50, 0x4e, 0x47]], ["image/jpeg", [0xff, 0xd8, 0xff]]];

interface Bytes {
  payload: Uint8Array;
  /** All of them are there. */
  whole: boolean;
}
interface Seen extends Bytes {
  key: string;
  time_ms: number;
  size: number;
  properties: Record<string, string>;
}

export function decode(base64: string): Uint8Array<ArrayBuffer> {
  const text = atob(base64);
  const all = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) all[i] = text.charCodeAt(i);
  return all;
}

function textOf(payload: Uint8Array): string | null {
  try {
    const text = new TextDecoder("utf-8", {fatal: true}).decode(payload);
    // eslint-disable-next-line no-control-regex
    return /[\u0000-\u0008\u000b\u000c\u000e-\u001f\u007f]/.test(text) ? null : text;
  } catch {
    return null;
  }
}

function Picture({payload, kind}: {payload: Uint8Array; kind: string}) {
  const [url, setUrl] = useState("");
  useEffect(() => {
    const made = URL.createObjectURL(new Blob([payload as Uint8Array<ArrayBuffer>], {type: kind}));
    setUrl(made);
    return () => URL.revokeObjectURL(made);
  }, [payload]);
  return url ? <img src={url} alt="The message's picture" class="picture" /> : null;
}

function Payload({of}: {of: Bytes}) {
  const kind = of.whole && pictureKinds.find(([, magic]) => magic.every((byte, index) => of.payload[index] === byte));
  if (kind) return <Picture payload={of.payload} kind={kind[0]} />;
  if (of.whole && looksLikeDepth(of.payload)) return <Depth payload={of.payload} />;
  const text = textOf(of.payload);
  if (text !== null) {
    try {
      return <pre>{JSON.stringify(JSON.parse(text), null, 1)}</pre>;
    } catch {
      return <pre>{text.slice(0, 4000)}{of.whole && text.length <= 4000 ? "" : " ..."}</pre>;
    }
  }
  const hex = [...of.payload.slice(0, 256)].map((byte) => byte.toString(16).padStart(2, "0")).join(" ");
  return <pre class="hex">{hex}{of.payload.length > 256 || !of.whole ? " ..." : ""}</pre>;
}

function ChannelTap({gateway, instance, channel}: {gateway: string; instance: string; channel: string}) {
  const [seen, setSeen] = useState<Seen[]>([]);
  const [paused, setPaused] = useState(false);
  const [words, setWords] = useState("");
  const [problem, setProblem] = useState("");
  const former = useRef<{count: number; elapsed_us: number} | null>(null);
  const pictures = seen.some((message) => looksLikeDepth(message.payload));  // then a few a second
  const args = {gateway, instance, channel, look: lookName, most: pictures ? 1 : 16, bytes: pictures ? 262_144 : 131_072};
  useRepeated(async () => {
    try {
      const look = await call("look", args);
      setProblem(look.problem ?? "");
      if (look.problem) return;
      const was = former.current;
      former.current = look;
      if (was && look.elapsed_us > was.elapsed_us) {
        const rate = (look.count - was.count) / ((look.elapsed_us - was.elapsed_us) / 1e6);
        setWords(`${count(rate)} messages/s; ${look.missed ? `${count(look.missed)} more than are shown` : "all are shown"}`);
      }
      const fresh: Seen[] = look.messages.map((message: any) => {
        const payload = decode(message.payload);
        return {key: `${message.number} ${message.seen_ms}`, time_ms: message.seen_ms, size: message.size, payload, whole: payload.length >= message.size,
                properties: message.properties ?? {}};
      });
      if (fresh.length) setSeen((all) => [...fresh.reverse(), ...all].slice(0, pictures ? keptPictures : kept));
    } catch (error) {
      setProblem(error instanceof Refused ? error.message : "the master does not answer");
    }
  }, 400, [gateway, instance, channel, pictures], !paused);
  useEffect(() => () => { void call("look", {...args, most: 0, last: true}).catch(() => undefined); }, [gateway, instance, channel]);
  return (
    <Panel title={`${channel} of ${instance}`} more={<><span class="quiet">{words}</span>
      <button type="button" aria-pressed={paused} onClick={() => setPaused(!paused)}>{paused ? "Go on" : "Pause"}</button></>}>
      {problem && <p class="problem" role="alert">{problem}</p>}
      {!seen.length ? <Empty>Nothing has passed yet.</Empty> : (
        <ol class="messages">{seen.map((message) => (
          <li key={message.key}><header>{time(message.time_ms)} · {bytes(message.size)}
            {Object.entries(message.properties).map(([key, value]) => <span key={key} class="tag">{key}={value}</span>)}</header><Payload of={message} /></li>))}</ol>
      )}
    </Panel>
  );
}

interface Field {
  name: string;
  text: string;
  /** Instead of a text. */
  bytes?: Bytes;
}

/** A worker tells of a payload how long it is, and its first bytes (topology/worker/pages.h). */
function fieldOf([name, value]: [string, any]): Field {
  const {bytes: size, hex, text} = value ?? {};
  const shown = typeof text === "string" ? text : value;
  if (typeof size !== "number" || typeof hex !== "string" || shown === text)
    return {name, text: typeof shown === "string" ? shown : JSON.stringify(shown)};
  const payload = Uint8Array.from(hex ? hex.split(" ") : [], (digits) => parseInt(digits, 16));
  return {name, text: `, ${bytes(size)}`, bytes: {payload, whole: payload.length === size}};
}

/** \param stream only its tuples; empty: all */
function TupleTap({topology, component, stream}: {topology: string; component: string; stream: string}) {
  const {state} = useKnown();
  const workers = state?.topologies.find((one) => one.name === topology)?.workers.map((worker) => worker.name) ?? [];
  const [seen, setSeen] = useState<{key: number; worker: string; fields: Field[]; time_ms: number; stream: string}[]>([]);
  const [problem, setProblem] = useState("");
  const [paused, setPaused] = useState(false);
  const number = useRef(0);
  // A worker knows a tap by its id alone, so each component's and stream's has its own.
  const targetOf = (more: Record<string, string>): string =>
    `/tap?${new URLSearchParams({id: `${lookName} ${component} ${stream}`, ...more}).toString().replaceAll("+", "%20")}`;
  const asked = useRef(Promise.resolve());  // the end goes to the workers after the last poll, which would begin anew
  const poll = async (): Promise<void> => {
    for (const worker of workers) {
      try {
        const target = targetOf({component, stream, rate: "5", bytes: "131072"});
        const got = await call("worker", {topology, worker, target});
        setProblem("");
        const fresh = got.samples.map((sample: any) => ({key: ++number.current, worker, time_ms: sample.time_ms, stream: `${sample.source} ${sample.stream}`,
                                                         fields: Object.entries(sample.fields).map(fieldOf)}));
        const large = fresh.some((tuple: {fields: Field[]}) => tuple.fields.some((field) => field.bytes?.whole && field.bytes.payload.length > 4096));
        if (fresh.length) setSeen((all) => [...fresh.reverse(), ...all].slice(0, large ? keptPictures : kept));
      } catch (error) {
        setProblem(error instanceof Refused ? error.message : "the master does not answer");
      }
    }
  };
  useRepeated(() => (asked.current = poll()), 600, [topology, component, stream, workers.join()], !paused);
  useEffect(() => () => {
    void asked.current.then(() => {
      for (const worker of workers) void call("worker", {topology, worker, target: targetOf({end: "1"})}).catch(() => undefined);
    });
  }, [topology, component, stream, workers.join()]);
  return (
    <Panel title={`Tuples of ${component} in ${topology}${stream ? `, stream ${stream}` : ""}`} more={<button type="button" aria-pressed={paused} onClick={() => setPaused(!paused)}>{paused ? "Go on" : "Pause"}</button>}>
      {problem && <p class="problem" role="alert">{problem}</p>}
      {!seen.length ? <Empty>Nothing has passed yet.</Empty> : (
        <ol class="messages">{seen.map((tuple) => (
          <li key={tuple.key}><header>{time(tuple.time_ms)} · {tuple.stream}{workers.length > 1 ? ` · ${tuple.worker}` : ""}</header>
            {tuple.fields.map((field) => field.bytes ? <div key={field.name}><span class="quiet">{field.name}{field.text}</span><Payload of={field.bytes} /></div>
              : <pre key={field.name}>{field.name}: {field.text}</pre>)}</li>))}</ol>
      )}
    </Panel>
  );
}

export function Tap({query}: {query: URLSearchParams}) {
  const {rows, state} = useKnown();
  const [gateway, instance, channel] = ["gateway", "instance", "channel"].map((key) => query.get(key) ?? "") as [string, string, string];
  const [topology, component, stream] = ["topology", "component", "stream"].map((key) => query.get(key) ?? "") as [string, string, string];
  const [channels, setChannels] = useState<string[]>([]);
  const [pick, setPick] = useState(instance ? `${gateway}/${instance}` : "");
  useEffect(() => {
    const row = rows.get(pick);
    if (!row) return setChannels([]);
    get(`/api/instance?${new URLSearchParams({gateway: row.gateway, instance: row.instance})}`)
      .then((record) => setChannels(record.channels.map((one: {name: string}) => one.name)), () => setChannels([]));
  }, [pick, rows.has(pick)]);
  const all = [...rows].slice(0, 1000);
  return (
    <>
      <h1>Tap</h1>
      <div class="search">
        <label>Instance <select value={pick} onChange={(event) => setPick(event.currentTarget.value)}>
          <option value="">choose ...</option>
          {pick && !all.some(([key]) => key === pick) && <option value={pick}>{pick}</option>}
          {all.map(([key, row]) => <option key={key} value={key}>{nameOf(row)} ({row.driver}, {row.gateway})</option>)}</select></label>
        <label>Channel <select value={channel} disabled={!channels.length} onChange={(event) => {
          const row = rows.get(pick);
          if (row) location.hash = `#/tap?${new URLSearchParams({gateway: row.gateway, instance: row.instance, channel: event.currentTarget.value})}`;
        }}><option value="">choose ...</option>
          {channel && !channels.includes(channel) && <option>{channel}</option>}
          {channels.map((name) => <option key={name}>{name}</option>)}</select></label>
        <label>or tuples of <select value={topology && component ? `${topology}/${component}` : ""} onChange={(event) => {
          const [name, ...rest] = event.currentTarget.value.split("/");
          if (name) location.hash = `#/tap?${new URLSearchParams({topology: name, component: rest.join("/")})}`;
        }}><option value="">choose ...</option>
          {state?.topologies.flatMap((one) => [...one.spouts, ...one.bolts].map((id) => <option key={`${one.name}/${id}`} value={`${one.name}/${id}`}>{id} in {one.name}</option>))}
        </select></label>
      </div>
      {topology && component ? <TupleTap topology={topology} component={component} stream={stream} />
        : channel ? <ChannelTap gateway={gateway} instance={instance} channel={channel} />
        : <Empty>Choose an instance and its channel, or a component of a topology. Nothing is sampled before, and nothing after you leave.</Empty>}
    </>
  );
}
