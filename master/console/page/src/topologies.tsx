// Topologies: the graph as it runs, and every number of it.
import type dagre from "@dagrejs/dagre";
import {useEffect, useMemo, useState} from "preact/hooks";
import {call, Refused, type Task, type TopologyPages, type TopologyState, type WorkerPage} from "./api";
import {useRepeated} from "./instance";
import {act, confirm, Empty, mayAct, Panel, Spread, State, together, useKnown, useLoaded} from "./parts";
import {age, bytes, count, duration, plural, time} from "./words";

type Input = WorkerPage["components"][number]["inputs"][number];

interface Component {
  id: string;
  kind: "spout" | "bolt";
  inputs: Input[];
  streams: Record<string, string[]>;
  parallelism: number;
  mostParallelism: number;
  tasks: (Task & {worker: string})[];
  emittedRate: number | null;
  executedRate: number | null;
  /** By stream. */
  out: Map<string, {emitted: number; transferred: number; rate: number | null}>;
  /** By stream that it reads. */
  read: {from: string; stream: string; groupings: string; executed: number; acked: number; failed: number; late: number; rate: number | null}[];
}

const isOf = (one: {from: string; stream: string}, other: {from: string; stream: string}): boolean => one.from === other.from && one.stream === other.stream;
const groupingText = (input: Input): string => `${input.grouping}${input.fields.length ? ` ${input.fields.join(", ")}` : ""}`;

const sum = (tasks: Task[], of: (task: Task) => number): number => tasks.reduce((all, task) => all + of(task), 0);
const most = (tasks: Task[], of: (task: Task) => number): number => tasks.reduce((all, task) => Math.max(all, of(task)), 0);

function componentsOf(now: TopologyPages, former: TopologyPages | null): Component[] {
  const seconds = former ? (now.at_ms - former.at_ms) / 1000 : 0;
  const all: Component[] = [];
  for (const spec of now.pages[0]?.components ?? []) {
    const tasks = now.pages.flatMap((page) => page.tasks.filter((task) => task.component === spec.id).map((task) => ({...task, worker: page.worker})));
    const then = former?.pages.flatMap((page) => page.tasks.filter((task) => task.component === spec.id)) ?? [];
    const rate = (of: (task: Task) => number): number | null =>
      seconds > 0 && then.length ? Math.max(0, sum(tasks, of) - sum(then, of)) / seconds : null;
    const each = now.pages.map((page) => page.components.find((one) => one.id === spec.id)).filter((one) => !!one);
    // A task that emits to one stream does not count it apart.
    const of = (task: Task, stream: string, key: "emitted" | "transferred"): number => task.streams?.[stream]?.[key] ?? (Object.keys(task.streams ?? {}).length ? 0 : task[key]);
    const out = new Map(Object.keys(spec.streams).map((stream) => [stream, {
      emitted: sum(tasks, (task) => of(task, stream, "emitted")), transferred: sum(tasks, (task) => of(task, stream, "transferred")),
      rate: rate((task) => of(task, stream, "emitted")),
    }]));
    // Several groupings may read one stream. A task that reads one stream does not count it apart.
    const streams = spec.inputs.filter((input, index) => spec.inputs.findIndex((one) => isOf(one, input)) === index);
    const did = (task: Task, input: Input, key: "executed" | "acked" | "failed" | "late"): number =>
      (streams.length > 1 ? task.inputs?.find((one) => isOf(one, input)) : task)?.[key] ?? 0;
    const read = streams.map((input) => ({
      from: input.from, stream: input.stream, groupings: spec.inputs.filter((one) => isOf(one, input)).map(groupingText).join("; "),
      executed: sum(tasks, (task) => did(task, input, "executed")), acked: sum(tasks, (task) => did(task, input, "acked")),
      failed: sum(tasks, (task) => did(task, input, "failed")), late: sum(tasks, (task) => did(task, input, "late")),
      rate: rate((task) => did(task, input, "executed")),
    }));
    all.push({
      id: spec.id, kind: spec.kind, inputs: spec.inputs, streams: spec.streams, tasks,
      parallelism: each.reduce((number, one) => number + one.parallelism, 0), mostParallelism: spec.tasks,
      emittedRate: rate((task) => task.emitted), executedRate: rate((task) => task.executed), out, read,
    });
  }
  return all;
}

const heat = (capacity: number): string => (capacity >= 0.8 ? "hot" : capacity >= 0.5 ? "warm" : capacity > 0 ? "cool" : "idle");
const rateText = (rate: number | null): string => (rate === null ? "-" : `${count(rate)}/s`);

const layouts = {load: () => import("./layout"), loaded: null as typeof dagre | null};

function Graph({components, chosen, choose}: {components: Component[]; chosen: string; choose: (id: string) => void}) {
  const shape = components.map((one) => one.id + one.inputs.map((input) => input.from + input.stream).join()).join("|");
  const placing = useLoaded(layouts);
  const layout = useMemo(() => {
    if (!placing) return null;
    const graph = new placing.graphlib.Graph({multigraph: true});
    graph.setGraph({rankdir: "LR", nodesep: 28, ranksep: 110, marginx: 12, marginy: 12});
    graph.setDefaultEdgeLabel(() => ({}));
    for (const one of components) graph.setNode(one.id, {width: 178, height: 74});
    for (const one of components) {
      for (const input of one.inputs) {
        if (components.some((other) => other.id === input.from)) graph.setEdge(input.from, one.id, {}, input.stream);
      }
    }
    placing.layout(graph);
    return graph;
  }, [shape, placing]);
  if (!layout) return <Empty>...</Empty>;
  const size = layout.graph() as {width?: number; height?: number};
  return (
    <div class="scroll">
      <svg class="graph" width={size.width ?? 0} height={size.height ?? 0} viewBox={`0 0 ${size.width ?? 0} ${size.height ?? 0}`}
           role="group" aria-label={`Graph of ${components.length} components`}>
        <defs><marker id="arrow" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" /></marker></defs>
        {layout.edges().map((edge) => {
          const points = (layout.edge(edge) as {points: {x: number; y: number}[]}).points;
          const from = components.find((one) => one.id === edge.v)!, to = components.find((one) => one.id === edge.w)!;
          const middle = points[Math.floor(points.length / 2)]!;
          const queue = sum(to.tasks, (task) => task.queue_depth);
          const rate = from.out.get(edge.name ?? "default")?.rate ?? null;
          return (
            <g key={`${edge.v} ${edge.w} ${edge.name}`} class={rate ? "edge flows" : "edge"}>
              <path d={points.map((point, index) => `${index ? "L" : "M"}${point.x} ${point.y}`).join("")} marker-end="url(#arrow)" />
              <text x={middle.x} y={middle.y - 7}>{edge.name === "default" ? "" : edge.name}</text>
              <text x={middle.x} y={middle.y + 13}>{rateText(rate)}{queue ? `, ${count(queue)} wait` : ""}</text>
            </g>
          );
        })}
        {components.map((one) => {
          const node = layout.node(one.id) as {x: number; y: number};
          const capacity = most(one.tasks, (task) => task.capacity);
          const errors = sum(one.tasks, (task) => task.errors);
          return (
            <g key={one.id} class={`node ${heat(capacity)}${one.id === chosen ? " chosen" : ""}`} transform={`translate(${node.x - 89} ${node.y - 37})`}
               role="button" tabIndex={0} aria-pressed={one.id === chosen}
               onClick={() => choose(one.id)} onKeyDown={(event) => { if (event.key === "Enter" || event.key === " ") { choose(one.id); event.preventDefault(); } }}>
              <rect width="178" height="74" rx={one.kind === "spout" ? 22 : 6} />
              <text x="89" y="23" class="id">{one.id.length > 22 ? `${one.id.slice(0, 21)}…` : one.id}</text>
              <text x="89" y="42">{`${one.kind} · ${one.parallelism} of ${plural(one.tasks.length, "task")}`}</text>
              <text x="89" y="60">{`${rateText(one.kind === "spout" ? one.emittedRate : one.executedRate)} · ${Math.round(capacity * 100)} % busy`}</text>
              {errors > 0 && <circle cx="168" cy="10" r="6" class="mark"><title>{plural(errors, "error")}</title></circle>}
            </g>
          );
        })}
      </svg>
    </div>
  );
}

const order = (topology: string, change: string, parallelism: Record<string, number> = {}): Promise<boolean> =>
  act(`${change[0]!.toUpperCase()}${change.slice(1)} ${topology}`, () => call("topology", {topology, change, parallelism}));

function Rebalance({topology, components}: {topology: TopologyState; components: Component[]}) {
  const [wanted, setWanted] = useState<Record<string, number>>({});
  const workers = Math.max(1, topology.workers.length);
  const changes = Object.entries(wanted).filter(([id, number]) => {
    const one = components.find((component) => component.id === id);
    return one && number !== Math.round(one.parallelism / workers);
  });
  return (
    <form class="rebalance" onSubmit={async (event) => {
      event.preventDefault();
      const list = changes.map(([id, number]) => `${id}: ${number}`).join(", ");
      if (await confirm({title: `Rebalance ${topology.name}?`, act: "Rebalance", destroys: false,
                         text: <p>In each of {plural(workers, "worker")}, so many tasks run at the same time: {list}. No tuple is lost.</p>}) &&
          await order(topology.name, "rebalance", Object.fromEntries(changes))) setWanted({});
    }}>
      {components.filter((one) => one.mostParallelism > 1).map((one) => {
        const now = wanted[one.id] ?? Math.round(one.parallelism / workers);
        return (
          <label key={one.id}><span>{one.id}</span>
            <input type="range" min={1} max={one.mostParallelism} value={now}
                   onInput={(event) => setWanted({...wanted, [one.id]: Number(event.currentTarget.value)})} />
            <output>{now} of {one.mostParallelism}</output></label>
        );
      })}
      {components.some((one) => one.mostParallelism > 1) ? <button type="submit" disabled={!changes.length}>Rebalance</button>
        : <span class="quiet">Each component has one task, so there is nothing to rebalance.</span>}
    </form>
  );
}

const keeps = (tasks: Task[]): boolean => tasks.some((task) => task.window_tuples != null || task.state_entries != null);
const kept = (tasks: Task[], of: (task: Task) => number | null | undefined): number | null =>
  tasks.some((task) => of(task) != null) ? tasks.reduce((all, task) => all + (of(task) ?? 0), 0) : null;

/** What windows and states hold now, of each component and its tasks. */
function Kept({components}: {components: Component[]}) {
  const some = components.filter((one) => keeps(one.tasks));
  if (!some.length) return null;
  const cells = (tasks: Task[]) => {
    const [tuples, entries, size] = [kept(tasks, (task) => task.window_tuples), kept(tasks, (task) => task.state_entries), kept(tasks, (task) => task.state_bytes)];
    return <><td class="n">{tuples === null ? "-" : count(tuples)}</td><td class="n">{entries === null ? "-" : count(entries)}</td><td class="n">{size === null ? "-" : bytes(size)}</td></>;
  };
  return (
    <Panel title="Windows and state">
      <div class="scroll" tabIndex={0} role="group" aria-label="What tasks keep"><table>
        <thead><tr><th>Component</th><th>Task</th><th class="n">Tuples in windows</th><th class="n">Keys of the state</th><th class="n">Bytes of the state</th></tr></thead>
        <tbody>{some.flatMap((one) => [
          <tr key={one.id}><td><b>{one.id}</b></td><td>all</td>{cells(one.tasks)}</tr>,
          ...(one.tasks.length > 1 ? one.tasks.map((task) => <tr key={`${one.id} ${task.worker} ${task.task}`}><td /><td>{task.task} <span class="quiet">{task.worker}</span></td>{cells([task])}</tr>) : []),
        ])}</tbody>
      </table></div>
    </Panel>
  );
}

interface Units {
  worker: string;
  spouts: {component: string; units: {unit: string; task: number}[]; more: number}[];
}

/** Which worker's task reads which unit of placement; asked for only while it is open. */
function Readers({topology}: {topology: TopologyState}) {
  const [open, setOpen] = useState(false);
  const [all, setAll] = useState<Units[] | null>(null);
  const [problem, setProblem] = useState("");
  const [search, setSearch] = useState("");
  const names = topology.workers.map((worker) => worker.name).join();
  useRepeated(async () => {
    try {
      setAll(await Promise.all(topology.workers.map((worker) => call("worker", {topology: topology.name, worker: worker.name, target: "/units"}))));
      setProblem("");
    } catch (error) {
      setProblem(error instanceof Refused ? error.message : "the master does not answer");
    }
  }, 3000, [topology.name, names], open);
  const lines = (all ?? []).flatMap((one) => one.spouts.flatMap((spout) => spout.units.map((unit) => ({...unit, spout: spout.component, worker: one.worker}))));
  const more = (all ?? []).reduce((sum, one) => sum + one.spouts.reduce((these, spout) => these + spout.more, 0), 0);
  const found = lines.filter((line) => !search || `${line.unit} ${line.spout} ${line.worker}`.includes(search));
  return (
    <Panel title="Who reads what" more={<button type="button" aria-expanded={open} onClick={() => setOpen(!open)}>{open ? "Hide" : "Show"}</button>}>
      {problem && <p class="problem" role="alert">{problem}</p>}
      {!open ? <Empty>Each unit of placement (a driver instance, or a driver on a gateway) is read by one task of one worker.</Empty> : !all ? <Empty>...</Empty> : (
        <>
          <div class="search inside"><label>Find <input value={search} size={24} onInput={(event) => setSearch(event.currentTarget.value)} /></label>
            <span class="quiet">{plural(found.length, "unit")}{found.length > 300 ? ", of which 300 are shown" : ""}{more ? `; ${more} more are not listed by their workers` : ""}</span></div>
          <div class="scroll tall-scroll" tabIndex={0} role="group" aria-label="Units"><table>
            <thead><tr><th>Unit</th><th>Spout</th><th class="n">Task's index</th><th>Worker</th></tr></thead>
            <tbody>{found.slice(0, 300).map((line) => (
              <tr key={`${line.worker} ${line.spout} ${line.unit}`}><td>{line.unit}</td><td>{line.spout}</td><td class="n">{line.task}</td><td>{line.worker}</td></tr>))}</tbody>
          </table></div>
        </>
      )}
    </Panel>
  );
}

interface TopologyEvent {
  time_ms: number;
  order: string;
  version: number;
  workers: number;
  outcome: string;
}

/** What was submitted, updated, rolled back and killed, of a topology that runs on pools. */
function Versions({topology}: {topology: TopologyState}) {
  const [events, setEvents] = useState<TopologyEvent[]>([]);
  const [problem, setProblem] = useState("");
  useEffect(() => {
    let ended = false;
    call("topology_history", {topology: topology.name}).then((all) => { if (!ended) setEvents(all.reverse()); },
      (error) => { if (!ended) setProblem(error instanceof Refused ? error.message : "the master does not answer"); });
    return () => { ended = true; };
  }, [topology.name, topology.revision, topology.version]);
  return (
    <Panel title="Versions">
      {problem && <p class="problem" role="alert">{problem}</p>}
      <div class="scroll" tabIndex={0} role="group" aria-label="Orders for the topology"><table>
        <thead><tr><th>Time (UTC)</th><th>Order</th><th class="n">Version</th><th class="n">Workers</th><th>Outcome</th></tr></thead>
        <tbody>{events.map((event) => (
          <tr key={`${event.time_ms} ${event.order}`}><td>{time(event.time_ms)}</td><td>{event.order}</td><td class="n">{event.version}</td><td class="n">{event.workers}</td><td>{event.outcome}</td></tr>))}</tbody>
      </table></div>
    </Panel>
  );
}

const spanText = (ms: number): string => (ms >= 7.2e6 ? plural(Math.round(ms / 3.6e6), "hour") : duration(ms * 1000));

/** Counts that are told of some time ago, too: master/console/live.cc. */
const spanCounts = ["emitted", "transferred", "executed", "acked", "failed", "timed_out", "late", "superseded"] as const;

const lastError = (tasks: (Task & {worker: string})[]): string => {
  const one = tasks.find((task) => task.last_error);
  return one ? `${one.last_error} (task ${one.task} in ${one.worker})` : "";
};

/** What is emitted to each stream, and who reads it. */
function Streams({topology, components}: {topology: string; components: Component[]}) {
  const lines = components.flatMap((one) => [...one.out].map(([stream, counts]) => ({one, stream, counts,
    readers: components.flatMap((other) => other.inputs.filter((input) => input.from === one.id && input.stream === stream)
      .map((input) => `${other.id} (${groupingText(input)})`))})));
  if (!lines.length) return null;
  return (
    <Panel title="Streams">
      <div class="scroll" tabIndex={0} role="group" aria-label="What is emitted to each stream"><table>
        <thead><tr><th>Component</th><th>Stream</th><th>Fields</th><th>Read by</th><th class="n">Tuples/s</th><th class="n">Emitted</th><th class="n">Transferred</th><th><span class="hidden">Acts</span></th></tr></thead>
        <tbody>{lines.map(({one, stream, counts, readers}) => (
          <tr key={`${one.id} ${stream}`}><td>{one.id}</td><td>{stream}</td><td>{one.streams[stream]?.join(", ")}</td><td>{readers.join(", ") || <span class="quiet">nobody</span>}</td>
            <td class="n">{rateText(counts.rate)}</td><td class="n">{count(counts.emitted)}</td><td class="n">{count(counts.transferred)}</td>
            <td><a href={`#/tap?${new URLSearchParams({topology, component: one.id, stream})}`}>Look</a></td></tr>))}</tbody>
      </table></div>
    </Panel>
  );
}

/** What each bolt has done with the tuples of each stream that it reads. */
function InputStats({components}: {components: Component[]}) {
  const lines = components.flatMap((one) => one.read.map((input) => ({one, input})));
  if (!lines.length) return null;
  return (
    <Panel title="Input stats">
      <div class="scroll" tabIndex={0} role="group" aria-label="What bolts did with each stream"><table>
        <thead><tr><th>Bolt</th><th>Component</th><th>Stream</th><th>Grouping</th><th class="n">Executed/s</th><th class="n">Executed</th><th class="n">Acked</th><th class="n">Failed</th><th class="n">Late</th></tr></thead>
        <tbody>{lines.map(({one, input}) => (
          <tr key={`${one.id} ${input.from} ${input.stream}`}><td>{one.id}</td><td>{input.from}</td><td>{input.stream}</td><td>{input.groupings}</td>
            <td class="n">{rateText(input.rate)}</td>{[input.executed, input.acked, input.failed, input.late].map((number, index) => <td key={index} class="n">{count(number)}</td>)}</tr>))}</tbody>
      </table></div>
    </Panel>
  );
}

function Topology({topology, component, pages, former}: {topology: TopologyState; component: string; pages: TopologyPages | null; former: TopologyPages | null}) {
  const [chosen, setChosen] = useState(component);
  const [span, setSpan] = useState(0);
  const former_ = pages?.former?.find((each) => each.span_ms === span);
  const counted = (tasks: Task[], component: string, key: keyof Task & string): number =>
    Math.max(0, sum(tasks, (task) => task[key] as number) - (former_?.components[component]?.[key] ?? 0));
  const components = useMemo(() => (pages ? componentsOf(pages, former) : []), [pages]);
  const one = components.find((component) => component.id === chosen);
  const troubles = pages?.pages.flatMap((page) => page.troubles.map((trouble) => ({...trouble, worker: page.worker}))) ?? [];
  const links = pages?.pages.flatMap((page) => page.brokers.filter((link) => link.state !== "connected").map((link) => ({...link, worker: page.worker}))) ?? [];
  const tasks = components.flatMap((component) => component.tasks);
  return (
    <>
      <h1>{topology.name} <State of={topology.workers.length ? topology.wanted || "active" : "gone"} /></h1>
      {mayAct() && (
        <div class="acts" role="group" aria-label="Acts">
          <button type="button" onClick={() => void order(topology.name, "activate")}>Activate</button>
          <button type="button" onClick={async () => {
            if (await confirm({title: `Deactivate ${topology.name}?`, act: "Deactivate", destroys: true,
                               text: <p>The spouts in {plural(topology.workers.length, "worker")} read nothing until you activate it. What is under way goes on.</p>}))
              void order(topology.name, "deactivate");
          }}>Deactivate</button>
          <button type="button" class="destroys" onClick={async () => {
            if (await confirm({title: `Kill ${topology.name}?`, act: "Kill", destroys: true, type: topology.name,
                               text: <p>{plural(topology.workers.length, "worker")} on {[...new Set(topology.workers.map((worker) => worker.host))].join(", ")} finish
                                 what is under way, and end. {plural(sum(tasks, (task) => task.pending), "tuple")} pending now.</p>}))
              void order(topology.name, "kill");
          }}>Kill</button>
        </div>
      )}
      {pages?.problems.map((problem) => <p key={problem.worker} class="problem" role="alert">{problem.worker}: {problem.problem}</p>)}
      {troubles.map((trouble) => <p key={trouble.worker + trouble.component} class="problem">{trouble.component} in {trouble.worker}: {trouble.text}</p>)}
      {links.map((link) => <p key={link.worker + link.url} class="problem">broker {link.broker} ({link.url}) is {link.state} for {age(link.since_ms)}: {link.why}</p>)}
      {!pages ? <Empty>{topology.workers.length ? "The master is reading the workers' pages ..." : "No worker runs it."}</Empty> : (
        <>
          <dl class="facts panel">
            <dt>Runs for</dt><dd>{age(topology.since_ms)}</dd>
            <dt>Workers</dt><dd>{topology.workers.length}{topology.wanted_workers ? ` of ${topology.wanted_workers}` : ""} on {plural(new Set(topology.workers.map((worker) => worker.host)).size, "host")}</dd>
            <dt>Executors, tasks</dt><dd>{components.reduce((all, each) => all + each.parallelism, 0)}, {tasks.length}</dd>
            <dt>Order</dt><dd>{topology.revision || "none"}{topology.version ? `, version ${topology.version}` : ""}</dd>
          </dl>
          <Panel title="As it runs" more={<span class="legend quiet"><i class="idle" /> idle <i class="cool" /> busy <i class="warm" /> from 50 % <i class="hot" /> from 80 %</span>}>
            <Graph components={components} chosen={chosen} choose={(id) => setChosen(id === chosen ? "" : id)} />
          </Panel>
          <Panel title={one ? `Tasks of ${one.id}` : "Components"} more={one && <span><a href={`#/tap?${new URLSearchParams({topology: topology.name, component: one.id})}`}>Look at its tuples</a>
            {" "}<button type="button" onClick={() => setChosen("")}>All components</button></span> || (
            <label>Counts <select value={former_ ? span : 0} onChange={(event) => setSpan(Number(event.currentTarget.value))}>
              <option value={0}>since the start</option>
              {(pages.former ?? []).map((each) => <option key={each.span_ms} value={each.span_ms}>of the last {spanText(each.span_ms)}</option>)}
            </select></label>)}>
            <div class="scroll"><table>
              <thead><tr><th>{one ? "Task" : "Component"}</th><th class="n">{one ? "Worker" : "Executors of tasks"}</th><th class="n">Busy</th>
                <th>Execute <span class="quiet">p50 · p99 · max</span></th><th>Process</th><th>Complete</th><th class="n">Emitted</th><th class="n">Transferred</th>
                <th class="n">Executed</th><th class="n">Acked</th><th class="n">Failed</th><th class="n">Timed out</th><th class="n">Late</th><th class="n">Superseded</th><th class="n">Waiting</th>
                <th class="n">Pending</th><th class="n">Errors</th><th>Last error</th></tr></thead>
              <tbody>
                {(one ? one.tasks.map((task) => ({name: String(task.task), more: task.worker, tasks: [task as Task], id: `${task.worker} ${task.task}`, rates: ""}))
                  : components.map((each) => ({name: each.id, more: `${each.parallelism} of ${each.tasks.length}`, tasks: each.tasks as Task[], id: each.id,
                                               rates: rateText(each.kind === "spout" ? each.emittedRate : each.executedRate)}))).map((line) => (
                  <tr key={line.id}>
                    <td>{one ? line.name : <button type="button" class="link" onClick={() => setChosen(line.id)}>{line.name}</button>} <span class="quiet">{line.rates}</span></td>
                    <td class="n">{line.more}</td>
                    <td class="n"><span class={`heat ${heat(most(line.tasks, (task) => task.capacity))}`}>{Math.round(most(line.tasks, (task) => task.capacity) * 100)} %</span></td>
                    <td><Spread name="execute" of={together(line.tasks.map((task) => task.execute))} /></td>
                    <td><Spread name="process" of={together(line.tasks.map((task) => task.process))} /></td>
                    <td><Spread name="complete" of={together(line.tasks.map((task) => task.complete))} /></td>
                    {spanCounts.map((key) => <td key={key} class="n">{count(one ? sum(line.tasks, (task) => task[key] as number) : counted(line.tasks, line.id, key))}</td>)}
                    <td class="n">{count(sum(line.tasks, (task) => task.queue_depth))}</td>
                    <td class="n">{count(sum(line.tasks, (task) => task.pending))}{most(line.tasks, (task) => task.oldest_s) > 0 ? `, ${duration(most(line.tasks, (task) => task.oldest_s) * 1e6)}` : ""}</td>
                    <td class="n">{count(sum(line.tasks, (task) => task.errors))}</td>
                    <td class="error">{lastError(line.tasks as (Task & {worker: string})[])}</td>
                  </tr>
                ))}
              </tbody>
            </table></div>
          </Panel>
          <Streams topology={topology.name} components={components} />
          <InputStats components={components} />
          <Kept components={components} />
          <Readers topology={topology} />
          {mayAct() && <Panel title="Rebalance"><Rebalance topology={topology} components={components} /></Panel>}
          <Panel title="What the spouts read">
            <div class="scroll"><table>
              <thead><tr><th>Spout</th><th>Worker</th><th class="n">Age of the newest message</th><th class="n">Backlog</th><th>Largest on</th></tr></thead>
              <tbody>{pages.pages.flatMap((page) => page.arrivals.map((arrival) => (
                <tr key={page.worker + arrival.component}><td>{arrival.component}</td><td>{page.worker}</td>
                  <td class="n">{arrival.age_s === null ? "-" : duration(arrival.age_s * 1e6)}</td><td class="n">{arrival.backlog === null ? "-" : count(arrival.backlog)}</td>
                  <td>{arrival.topic}{arrival.most ? ` (${count(arrival.most)})` : ""}</td></tr>)))}</tbody>
            </table></div>
          </Panel>
        </>
      )}
      {!!topology.version && <Versions topology={topology} />}
      <Panel title="Workers">
        <div class="scroll"><table>
          <thead><tr><th>Worker</th><th>State</th><th>Host</th><th class="n">Process</th><th>Pages</th><th>Since (UTC)</th><th class="n">Order</th><th>Trouble</th></tr></thead>
          <tbody>{topology.workers.map((worker) => (
            <tr key={worker.name}><td>{worker.name}</td><td><State of={worker.state} /></td><td>{worker.host}</td><td class="n">{worker.pid}</td><td>{worker.http || "none"}</td>
              <td>{time(worker.since_ms)}</td><td class="n">{worker.revision} of {topology.revision}</td><td>{[worker.trouble, worker.error].filter(Boolean).join("; ")}</td></tr>))}</tbody>
        </table></div>
      </Panel>
    </>
  );
}

/** \param component of the topology, that is chosen first; empty: none */
export function Topologies({name, component}: {name: string; component: string}) {
  const {state, topology, formerTopology} = useKnown();
  if (!state) return <Empty>...</Empty>;
  const found = state.topologies.find((one) => one.name === name);
  if (found) return <Topology key={`${name} ${component}`} topology={found} component={component} pages={topology?.topology === name ? topology : null} former={formerTopology} />;
  return (
    <>
      <h1>Topologies</h1>
      {name && <p class="problem" role="alert">There is no topology {name}.</p>}
      {!state.topologies.length ? <Empty>None runs. Try: iotcloud-topology --config topology.yaml</Empty> : (
        <div class="scroll"><table>
          <thead><tr><th>Topology</th><th>Wanted</th><th class="n">Workers</th><th>Hosts</th><th>Spouts</th><th>Bolts</th><th>Trouble</th></tr></thead>
          <tbody>{state.topologies.map((one) => (
            <tr key={one.name}><td><a href={`#/topology/${encodeURIComponent(one.name)}`}>{one.name}</a></td><td><State of={one.workers.length ? one.wanted || "active" : "gone"} /></td>
              <td class="n">{one.workers.length}{one.wanted_workers ? ` of ${one.wanted_workers}` : ""}</td><td>{[...new Set(one.workers.map((worker) => worker.host))].join(", ")}</td>
              <td>{one.spouts.join(", ")}</td><td>{one.bolts.join(", ")}</td><td>{one.workers.map((worker) => worker.trouble || worker.error).filter(Boolean).join("; ")}</td></tr>))}</tbody>
        </table></div>
      )}
    </>
  );
}
