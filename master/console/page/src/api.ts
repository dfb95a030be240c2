// What the page asks the master, and what the master tells it.

/** An answer of the master that says why not. */
export class Refused extends Error {
  constructor(text: string, readonly status: number) {
    super(text);
  }
}

async function read(answer: Response): Promise<any> {
  const text = await answer.text();
  let json: any = null;
  try {
    json = text ? JSON.parse(text) : {};
  } catch {
    throw new Refused(`the master's answer cannot be read (status ${answer.status})`, answer.status);
  }
  if (!answer.ok) throw new Refused(json.error ?? `status ${answer.status}`, answer.status);
  return json;
}

/** \param limit in ms, after which a master that does not answer counts as away; 0: none */
export async function get(path: string, limit = 0): Promise<any> {
  return read(await fetch(path, {headers: {Accept: "application/json"}, signal: limit ? AbortSignal.timeout(limit) : null}));
}

/** Calls of the console: master/console/console_calls.h. */
export async function call(name: string, args: object): Promise<any> {
  return read(await fetch(`/api/call/${name}`, {
    method: "POST",
    headers: {"Content-Type": "application/json"},
    body: JSON.stringify(args),
  }));
}

export async function logIn(token: string): Promise<void> {
  await read(await fetch("/api/session", {
    method: "POST",
    headers: {"Content-Type": "application/json"},
    body: JSON.stringify({token}),
  }));
}

export async function logOut(): Promise<void> {
  await read(await fetch("/api/session", {method: "DELETE"}));
}

export interface Me {
  master: string;
  log_in: boolean;
  name: string;
  role: "anyone" | "viewer" | "operator" | "admin";
  others: string[];
}

export interface Row {
  instance: string;
  gateway: string;
  driver: string;
  name: string;
  state: string;
  reason: string;
  since_ms: number;
  metadata: Record<string, string>;
  channels: number;
  starts_again?: boolean;
  lost?: boolean;
  /** A rule or finder of its gateway, if no master was ordered to make it. */
  made_by?: string;
}

/** What a topology's component lost of late. */
export interface Loss {
  topology: string;
  component: string;
  since_ms: number;
  counts: Partial<Record<"late" | "timed_out" | "failed" | "errors", number>>;
}

/** A plugin that a gateway has. */
export interface Plugin {
  file: string;
  sha256: string;
  sent: boolean;
  signed_by: string;
  signed_version: number;
  problem: string;
}

export interface Gateway {
  gateway: string;
  host: string;
  port: number;
  brokers: {name: string}[];
  since_ms: number;
  tls?: boolean;
  trouble?: string;
  alive: boolean;
  frozen?: string;
  draining: boolean;
  original: boolean;
}

export interface Worker {
  name: string;
  host: string;
  pid: number;
  http: string;
  state: string;
  revision: number;
  error: string;
  since_ms: number;
  trouble: string;
  components: Record<string, {parallelism: number; tasks: number}>;
}

export interface TopologyState {
  name: string;
  since_ms: number;
  spouts: string[];
  bolts: string[];
  workers: Worker[];
  wanted: string;
  revision: number;
  version?: number;
  wanted_workers?: number;
}

export interface State {
  problem: string;
  master: {id: string; leading: boolean; epoch: number; leader: string; registry_away: boolean};
  gateways: Gateway[];
  topologies: TopologyState[];
  instances: number;
  counts: Record<string, number>;
  faults: Row[];
  number_of_faults: number;
  losses?: Loss[];
}

export interface Latency {
  count: number;
  p50_us: number;
  p99_us: number;
  max_us: number;
  buckets?: [number, number][];
}

export interface Task {
  component: string;
  task: number;
  emitted: number;
  transferred: number;
  /** Each stream's part of these, if there are several. */
  streams?: Record<string, {emitted: number; transferred: number}>;
  /** Each input's part of what follows, if there are several. */
  inputs?: {from: string; stream: string; executed: number; acked: number; failed: number; late: number}[];
  executed: number;
  acked: number;
  failed: number;
  timed_out: number;
  late: number;
  superseded: number;
  errors: number;
  queue_depth: number;
  pending: number;
  oldest_s: number;
  capacity: number;
  execute: Latency;
  process: Latency;
  complete: Latency;
  last_error: string;
  /** What it keeps; null: nothing of the kind. */
  window_tuples?: number | null;
  state_entries?: number | null;
  state_bytes?: number | null;
}

export interface WorkerPage {
  topology: string;
  worker: string;
  active: boolean;
  brokers: {broker: string; url: string; state: string; since_ms: number; why: string}[];
  arrivals: {component: string; age_s: number | null; backlog: number | null; topic: string; most: number}[];
  troubles: {component: string; text: string}[];
  components: {
    id: string;
    kind: "spout" | "bolt";
    parallelism: number;
    tasks: number;
    inputs: {from: string; stream: string; grouping: string; fields: string[]}[];
    streams: Record<string, string[]>;
  }[];
  tasks: Task[];
}

export interface TopologyPages {
  topology: string;
  at_ms: number;
  pages: WorkerPage[];
  /** What the components had counted some time ago. */
  former?: {span_ms: number; components: Record<string, Partial<Record<string, number>>>}[];
  problems: {worker: string; problem: string}[];
}

export interface Outcome {
  done: boolean;
  refused: boolean;
  leader: string;
  summary: string;
  outcomes: {instance?: string; worker?: string; gateway?: string; outcome: string; reason: string}[];
}
