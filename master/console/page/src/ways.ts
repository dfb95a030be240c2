// The way of one message, put together from what its driver host and the workers have written down, and as a trace file.

/** A clock that times are of: processes on one machine share one. */
export interface Clock {
  host: string;
  clock: string;
  /** So much more are microseconds since 1970, as that machine has it. */
  wall_us: number;
}

/** What a driver host saw of a message: discovery/channel_look.h. */
export interface SeenMessage {
  time_ms: number;
  size: number;
  came_us?: number;
  begin_us?: number;
  end_us?: number;
  fate?: string;
}
export interface Look extends Partial<Clock> {
  problem?: string;
  messages: SeenMessage[];
}

/** What a worker saw of a message: topology/worker/page_requests.h. */
interface Step {
  component: string;
  task: number;
  from: string;
  stream: string;
  emitted_us: number;
  begin_us: number;
  end_us: number;
  settled_us: number;
  acked: boolean;
}
interface WorkerWay {
  driver: string;
  time_ms: number;
  topic: string;
  spout: string;
  came_us: number;
  taken_us: number;
  done_us: number;
  outcome: string;
  tries: number;
  more_steps: number;
  steps: Step[];
}
export interface TracePage extends Clock {
  topology: string;
  worker: string;
  missed: number;
  ways: WorkerWay[];
}

export type Kind = "driver" | "broker" | "wait" | "work" | "confirm";

/** A part of the way; times in microseconds of the driver host's machine since 1970. */
export interface Part {
  name: string;
  where: string;
  /** Of the task, in a worker. */
  lane: string;
  kind: Kind;
  begin_us: number;
  end_us: number;
  /** Begin and end are by the clocks of two machines: the part is the difference of two clocks, no duration. */
  apart: boolean;
}

export interface Way {
  key: string;
  channel: string;
  time_ms: number;
  size: number;
  begin_us: number;
  end_us: number;
  /** It came back to the driver. */
  returned: boolean;
  notes: string[];
  parts: Part[];
}

/** An outgoing channel that is looked at, with what its topic's name ends with. */
export interface Outgoing {
  name: string;
  endings: string[];
}

interface Gathered {
  out: Map<string, SeenMessage>;
  back: Map<number, {channel: string; seen: SeenMessage}>;
  workers: Map<string, {page: Clock & {topology: string; worker: string}; way: WorkerWay}>;
}

const known = (us: number | undefined): us is number => us !== undefined && us > 0;

/** Gathers what each process tells, and puts the ways together. */
export class Ways {
  private host: Clock | null = null;
  private readonly all: Gathered = {out: new Map(), back: new Map(), workers: new Map()};

  constructor(private readonly where: string, private readonly channels: Outgoing[], private readonly most = 200) {}

  addOutgoing(channel: string, look: Look): void {
    this.take(look);
    for (const seen of look.messages) if (known(seen.begin_us)) this.keep(this.all.out, `${channel} ${seen.time_ms}`, seen);
  }

  addIncoming(channel: string, look: Look): void {
    this.take(look);
    for (const seen of look.messages) if (known(seen.begin_us)) this.keep(this.all.back, seen.time_ms, {channel, seen});
  }

  addWorker(page: TracePage): void {
    for (const way of page.ways) this.keep(this.all.workers, `${page.worker} ${way.topic} ${way.time_ms}`, {page, way});
  }

  private take(look: Look): void {
    if (look.clock !== undefined && look.wall_us !== undefined) this.host = {host: look.host ?? "", clock: look.clock, wall_us: look.wall_us};
  }

  private keep<K, V>(map: Map<K, V>, key: K, value: V): void {
    map.delete(key);
    map.set(key, value);
    while (map.size > 4 * this.most) map.delete(map.keys().next().value as K);
  }

  private isOf(channel: string, topic: string): boolean {
    const endings = this.channels.find((one) => one.name === channel)?.endings ?? [];
    return this.channels.length === 1 || endings.some((ending) => topic === ending || topic.endsWith(`.${ending}`));
  }

  /** The newest first. */
  list(): Way[] {
    const host = this.host;
    if (!host) return [];
    const ways = [...this.all.out].slice(-this.most).map(([key, seen]) => {
      const channel = key.slice(0, key.lastIndexOf(" "));
      const workers = [...this.all.workers.values()].filter((one) => one.way.time_ms === seen.time_ms && this.isOf(channel, one.way.topic));
      return this.together(key, channel, seen, host, workers);
    });
    return ways.sort((a, b) => b.begin_us - a.begin_us);
  }

  private together(key: string, channel: string, seen: SeenMessage, host: Clock,
                   workers: {page: Clock & {topology: string; worker: string}; way: WorkerWay}[]): Way {
    const parts: Part[] = [];
    const notes: string[] = [];
    const at = (clock: Clock, us: number): number => us + (clock.clock === host.clock ? host.wall_us : clock.wall_us);
    const begin = at(host, seen.begin_us!);
    const device = seen.time_ms * 1000;
    // The message's own time has a resolution of a millisecond.
    if (device < begin - 1000 && begin - device < 60e6)
      parts.push({name: "driver: from the message's time to publish", where: this.where, lane: channel, kind: "driver", begin_us: device, end_us: begin, apart: false});
    if (known(seen.end_us))
      parts.push({name: seen.fate === "confirmed" ? "broker confirms" : seen.fate ?? "broker", where: this.where, lane: channel, kind: "confirm",
                  begin_us: begin, end_us: at(host, seen.end_us), apart: false});
    if (seen.fate && seen.fate !== "confirmed") notes.push(seen.fate);
    let sent: {us: number; clock: Clock} | null = null;
    for (const {page, way} of workers) {
      const where = `${page.worker} (${page.topology})`;
      const apart = page.clock !== host.clock;
      if (apart) notes.push(`${page.worker} is on ${page.host || "another machine"}, whose clock is another one`);
      const came = at(page, way.came_us);
      parts.push({name: "broker: to the worker", where: "broker", lane: page.worker, kind: "broker", begin_us: begin, end_us: came, apart});
      if (!known(way.taken_us)) {
        notes.push(`no spout of ${page.topology} has taken it yet`);
        continue;
      }
      parts.push({name: `${way.spout}: waits`, where, lane: way.spout, kind: "wait", begin_us: came, end_us: at(page, way.taken_us), apart: false});
      if (way.outcome === "not followed") notes.push(`${way.spout} acks at once (ackMode: auto), so that its tuples are not followed`);
      if (way.outcome === "given up") notes.push(`${page.topology} has given it up`);
      if (way.tries > 1) notes.push(`${way.tries} tries in ${page.topology}`);
      if (way.more_steps) notes.push(`${way.more_steps} more steps in ${page.topology}`);
      for (const step of way.steps) {
        const lane = `${step.component} #${step.task}`;
        if (known(step.emitted_us) && known(step.begin_us))
          parts.push({name: `${step.component}: waits`, where, lane, kind: "wait", begin_us: at(page, step.emitted_us), end_us: at(page, step.begin_us), apart: false});
        if (known(step.begin_us) && known(step.end_us))
          parts.push({name: step.component, where, lane, kind: "work", begin_us: at(page, step.begin_us), end_us: at(page, step.end_us), apart: false});
        if (known(step.end_us) && step.settled_us > step.end_us)
          parts.push({name: `${step.component}: ${step.acked ? "acks" : "fails"} later`, where, lane, kind: "confirm",
                      begin_us: at(page, step.end_us), end_us: at(page, step.settled_us), apart: false});
        const emits = way.steps.some((other) => other.from === step.component && other.component !== step.component);
        if (!emits && known(step.end_us) && (!sent || at(page, step.end_us) > at(sent.clock, sent.us))) sent = {us: step.end_us, clock: page};
      }
    }
    const back = this.all.back.get(seen.time_ms);
    let end = Math.max(...parts.filter((part) => part.kind !== "confirm").map((part) => part.end_us), begin);
    if (back) {
      const came = known(back.seen.came_us) ? back.seen.came_us : back.seen.begin_us!;
      const lane = back.channel;
      if (sent) {
        parts.push({name: "broker: back to the driver", where: "broker", lane: "back", kind: "broker", begin_us: at(sent.clock, sent.us), end_us: at(host, came),
                    apart: sent.clock.clock !== host.clock});
      }
      parts.push({name: "driver: the answer waits", where: this.where, lane, kind: "wait", begin_us: at(host, came), end_us: at(host, back.seen.begin_us!), apart: false});
      if (known(back.seen.end_us)) {
        parts.push({name: "driver: handles the answer", where: this.where, lane, kind: "work", begin_us: at(host, back.seen.begin_us!), end_us: at(host, back.seen.end_us), apart: false});
        end = at(host, back.seen.end_us);
      } else {
        end = at(host, back.seen.begin_us!);
      }
    }
    return {key, channel, time_ms: seen.time_ms, size: seen.size, begin_us: begin, end_us: end, returned: !!back, notes: [...new Set(notes)], parts};
  }
}

/** The parts of many ways, by name, in the order in which they come: how long they took. */
export function summary(ways: Way[]): {name: string; kind: Kind; apart: boolean; times: number[]}[] {
  const all = new Map<string, {name: string; kind: Kind; apart: boolean; times: number[]; at: number}>();
  for (const way of ways) {
    for (const part of way.parts) {
      const one = all.get(part.name) ?? {name: part.name, kind: part.kind, apart: false, times: [], at: 0};
      one.times.push(part.end_us - part.begin_us);
      one.apart ||= part.apart;
      one.at += part.begin_us - way.begin_us;
      all.set(part.name, one);
    }
  }
  const sorted = [...all.values()].sort((a, b) => a.at / a.times.length - b.at / b.times.length);
  for (const one of sorted) one.times.sort((a, b) => a - b);
  return sorted;
}

/** The value below which the part `q` is. */
export const quantile = (sorted: number[], q: number): number => sorted[Math.min(sorted.length - 1, Math.ceil(q * sorted.length) - 1)] ?? 0;

/** A file in the Trace Event Format, which Perfetto (ui.perfetto.dev) and chrome://tracing read. */
export function traceFile(ways: Way[], about: Record<string, unknown>): string {
  const events: Record<string, unknown>[] = [];
  const processes = new Map<string, number>(), threads = new Map<string, number>();
  const pid = (where: string): number => {
    let known = processes.get(where);
    if (known === undefined) {
      processes.set(where, known = processes.size + 1);
      events.push({name: "process_name", ph: "M", pid: known, tid: 0, args: {name: where}});
    }
    return known;
  };
  const tid = (where: string, lane: string): number => {
    let known = threads.get(`${where}\n${lane}`);
    if (known === undefined) {
      threads.set(`${where}\n${lane}`, known = threads.size + 1);
      events.push({name: "thread_name", ph: "M", pid: pid(where), tid: known, args: {name: lane}});
    }
    return known;
  };
  const first = Math.min(...ways.map((way) => Math.min(way.begin_us, ...way.parts.map((part) => part.begin_us))));
  [...ways].sort((a, b) => a.begin_us - b.begin_us).forEach((way, number) => {
    for (const [place, part] of way.parts.entries()) {
      // What a task does, it does one after the other; what waits or is under way overlaps with that of other messages.
      const common = {name: part.name, cat: part.kind, pid: pid(part.where), tid: tid(part.where, part.lane), ts: part.begin_us - first};
      const args = {channel: way.channel, time_ms: way.time_ms, message: number + 1, ...(part.apart ? {clocks: "two machines'"} : {})};
      const long = Math.max(0, part.end_us - part.begin_us);
      if (part.kind === "work") {
        events.push({...common, ph: "X", dur: long, args});
      } else {
        // Each has an id of its own, because those of one id would have to lie within each other.
        const id = `0x${((number + 1) * 0x1000 + place).toString(16)}`;
        events.push({...common, ph: "b", id, args}, {...common, ph: "e", id, ts: common.ts + long});
      }
    }
  });
  return JSON.stringify({traceEvents: events, displayTimeUnit: "ms", otherData: {...about, begins_us: Math.round(first)}});
}
