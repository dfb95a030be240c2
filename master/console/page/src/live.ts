// The stream of changes, and what is known by it. One stream for a page; none while the page is hidden, because a browser
// has few connections to one host, and the master looks at nothing that nobody sees.
import {get, type Me, Refused, type Row, type State, type TopologyPages} from "./api";

/** A point of the last hour: time in ms, tuples a second, p99 in us. */
export type Point = [number, number, number | null];
/** And one of drivers: time in ms, messages a second from them, to them, p99 of their round trips in us. Null: not known. */
export type MessagesPoint = [number, number | null, number | null, number | null];

export interface Wanted {
  rows: boolean;
  where: string;
  topology: string;
}

export interface Known {
  me: Me | null;
  state: State | null;
  rows: Map<string, Row>;
  rowsComplete: boolean;
  points: Point[];
  messages: MessagesPoint[];
  topology: TopologyPages | null;
  formerTopology: TopologyPages | null;
  connected: boolean;
  silentSince: number;
  /** Why the instances of `Wanted.where` cannot be told; empty: they can. */
  whereProblem: string;
  /** Grows with each change of `rows`. */
  rowsVersion: number;
}

export const known: Known = {
  me: null, state: null, rows: new Map(), rowsComplete: false, points: [], messages: [], topology: null, formerTopology: null,
  connected: false, silentSince: Date.now(), whereProblem: "", rowsVersion: 0,
};

const listeners = new Set<() => void>();
let told = false;

export function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

/** Tells the parts of the page once for all that changes together. */
export function changed(): void {
  if (told) return;
  told = true;
  queueMicrotask(() => {
    told = false;
    for (const listener of [...listeners]) listener();
  });
}

const keyOf = (row: {gateway: string; instance: string}): string => `${row.gateway}/${row.instance}`;

let wanted: Wanted | null = null;
let stream: EventSource | null = null;
let retry = 0;
let hiddenSince = 0;
const hiddenLimit = 15_000;
const answerLimit = 3_000;
/** When something came last, and within how many ms the master sends something again. A machine that is switched off closes nothing. */
let heard = 0;
let beat = 10_000;
const beatsMissed = 2.5;

export function want(next: Wanted): void {
  const same = wanted && wanted.rows === next.rows && wanted.where === next.where && wanted.topology === next.topology;
  if (same && stream) return;
  if (!wanted || wanted.where !== next.where || !next.rows) {
    known.rows = new Map();
    known.rowsComplete = false;
    known.rowsVersion++;
  }
  if (!wanted || wanted.where !== next.where) known.whereProblem = "";
  if (!wanted || wanted.topology !== next.topology) known.topology = known.formerTopology = null;
  wanted = next;
  open();
  changed();
}

function close(): void {
  stream?.close();
  stream = null;
  clearTimeout(retry);
}

function open(): void {
  close();
  if (!wanted || known.me?.role === "anyone") return;
  const query = new URLSearchParams();
  if (wanted.rows && !known.whereProblem) query.set("rows", "1");
  if (wanted.where && !known.whereProblem) query.set("where", wanted.where);
  if (wanted.topology) query.set("topology", wanted.topology);
  const mine = new EventSource(`/api/live?${query}`);
  stream = mine;
  heard = Date.now();
  const on = (name: string, take: (data: any) => void) =>
    mine.addEventListener(name, (event) => {
      if (stream !== mine) return;
      known.connected = true;
      heard = Date.now();
      take(JSON.parse((event as MessageEvent).data));
      changed();
    });
  on("state", (data: State) => { known.state = data; });
  on("beat", (data: {ms: number}) => { beat = data.ms; });
  on("rows", (data: {reset: boolean; set: Row[]; gone: {gateway: string; instance: string}[]; more?: boolean}) => {
    if (data.reset) known.rows = new Map();
    for (const row of data.set) known.rows.set(keyOf(row), row);
    for (const row of data.gone) known.rows.delete(keyOf(row));
    known.rowsComplete = !data.more;
    known.rowsVersion++;
  });
  const together = <T,>(former: T[], data: {reset: boolean; points: T[]}): T[] => (data.reset ? data.points : [...former, ...data.points].slice(-360));
  on("series", (data: {reset: boolean; points: Point[]}) => { known.points = together(known.points, data); });
  on("messages", (data: {reset: boolean; points: MessagesPoint[]}) => { known.messages = together(known.messages, data); });
  on("topology", (data: TopologyPages) => {
    known.formerTopology = known.topology;
    known.topology = data;
  });
  on("over", () => {
    close();
    void whoAmI();
  });
  mine.onopen = () => {
    known.connected = true;
    changed();
  };
  mine.onerror = () => {
    if (stream === mine) lost();
  };
}

function lost(): void {
  if (known.connected) known.silentSince = heard;
  known.connected = false;
  changed();
  close();
  retry = window.setTimeout(() => void reconnect(), 1000);
}

window.setInterval(() => {
  if (stream && Date.now() - heard > beatsMissed * beat) lost();
}, 1000);

/** A stream that is refused does not say why: asks whether the selection is the reason. */
async function checkWhere(): Promise<void> {
  if (!wanted?.where) return;
  try {
    await get(`/api/live?check=1&where=${encodeURIComponent(wanted.where)}`, answerLimit);
  } catch (error) {
    if (!(error instanceof Refused) || error.status !== 400) throw error;
    known.whereProblem = error.message;
  }
}

/** The master was silent: asks it again, and then the consoles of the other masters. */
async function reconnect(): Promise<void> {
  try {
    known.me = await get("/api/me", answerLimit);
    await checkWhere();
    changed();
    return open();
  } catch {
    // it does not answer
  }
  for (const other of Date.now() - known.silentSince > 1500 ? known.me?.others ?? [] : []) {
    try {
      await fetch(`${other}/alive`, {mode: "no-cors", credentials: "omit", cache: "no-store",
                                     signal: AbortSignal.timeout(2000)});
      const [path] = location.hash.split("?");
      location.replace(`${other}/${path || "#/"}?instead-of=${encodeURIComponent(known.me?.master ?? location.host)}`);
      return;
    } catch {
      // nor does this one
    }
  }
  clearTimeout(retry);
  retry = window.setTimeout(() => void reconnect(), 1000);
}

export async function whoAmI(): Promise<void> {
  try {
    known.me = await get("/api/me", answerLimit);
  } catch {
    known.connected = false;
    clearTimeout(retry);
    retry = window.setTimeout(() => void whoAmI(), 1000);
  }
  changed();
  if (known.me?.role === "anyone") close();
  else if (known.me && wanted && !stream) open();
}

/** Ends when the state is known. */
export function stateCame(): Promise<void> {
  return new Promise((resolve) => {
    const look = (): void => {
      if (!known.state) return;
      forget();
      resolve();
    };
    const forget = subscribe(look);
    look();
  });
}

document.addEventListener("visibilitychange", () => {
  if (document.hidden) {
    hiddenSince = Date.now();
    window.setTimeout(() => {
      if (document.hidden && Date.now() - hiddenSince >= hiddenLimit) close();
    }, hiddenLimit);
  } else if (!stream && wanted) {
    open();
  }
});
