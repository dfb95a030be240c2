// Parts that several pages are made of.
import type {ComponentChildren} from "preact";
import {useEffect, useLayoutEffect, useRef, useState} from "preact/hooks";
import type uPlot from "uplot";
import {call, type Latency, type Outcome, Refused} from "./api";
import {known, subscribe} from "./live";
import {count, duration} from "./words";

/** Draws again when something is told; at once after the first drawing (no effect after it), so that nothing is told before. */
export function useKnown() {
  const [, draw] = useState(0);
  useLayoutEffect(() => subscribe(() => draw((n) => n + 1)), []);
  return known;
}

export const mayAct = (): boolean => known.me?.role === "operator" || known.me?.role === "admin";
export const isAdmin = (): boolean => known.me?.role === "admin";

export function State({of, lost}: {of: string; lost?: boolean}) {
  const word = lost ? "lost" : of;
  return <span class={`state state-${word}`}><span class="dot" aria-hidden="true" />{word}</span>;
}

export function Panel({title, children, more}: {title: string; children: ComponentChildren; more?: ComponentChildren}) {
  return (
    <section class="panel" aria-label={title}>
      <header><h2>{title}</h2>{more}</header>
      {children}
    </section>
  );
}

export function Empty({children}: {children: ComponentChildren}) {
  return <p class="empty">{children}</p>;
}

// ---- what people are asked before something is done, and what became of it

interface Question {
  title: string;
  text: ComponentChildren;
  act: string;
  destroys: boolean;
  /** What must be typed first; empty: nothing. */
  type?: string;
  answer: (yes: boolean) => void;
}
interface Told {
  id: number;
  text: string;
  kind: "busy" | "good" | "bad";
}
let question: Question | null = null;
let told: Told[] = [];
let lastTold = 0;
const noticeListeners = new Set<() => void>();
const notice = (): void => noticeListeners.forEach((listener) => listener());

export function confirm(asked: Omit<Question, "answer">): Promise<boolean> {
  return new Promise((resolve) => {
    question = {...asked, answer: (yes) => { question = null; notice(); resolve(yes); }};
    notice();
  });
}

export function tell(text: string, kind: Told["kind"]): number {
  const id = ++lastTold;
  told = [...told, {id, text, kind}];
  notice();
  if (kind === "good") window.setTimeout(() => untell(id), 6000);
  return id;
}
export function untell(id: number): void {
  told = told.filter((one) => one.id !== id);
  notice();
}

/** Does something, and tells how it went. */
export async function act(what: string, body: () => Promise<Outcome>): Promise<boolean> {
  const busy = tell(`${what} ...`, "busy");
  try {
    const result = await body();
    untell(busy);
    tell(`${what}: ${result.summary || (result.done ? "done" : "not done")}`, result.done ? "good" : "bad");
    return result.done;
  } catch (error) {
    untell(busy);
    tell(`${what}: ${error instanceof Refused ? error.message : "the master does not answer"}`, "bad");
    return false;
  }
}

export const order = (what: string, name: string, args: object): Promise<boolean> =>
  act(what, () => call("order", {order: name, with: args}));

export function Notices() {
  const [, draw] = useState(0);
  const dialog = useRef<HTMLDialogElement>(null);
  const [typed, setTyped] = useState("");
  useLayoutEffect(() => {
    const listener = (): void => draw((n) => n + 1);
    noticeListeners.add(listener);
    return () => { noticeListeners.delete(listener); };
  }, []);
  useEffect(() => {
    if (question && !dialog.current?.open) {
      setTyped("");
      dialog.current?.showModal();
    }
    if (!question && dialog.current?.open) dialog.current.close();
  });
  const asked = question;
  return (
    <>
      <div class="notices" role="status" aria-live="polite">
        {told.map((one) => (
          <div key={one.id} class={`notice ${one.kind}`}>
            <span>{one.text}</span>
            <button type="button" aria-label="Dismiss" onClick={() => untell(one.id)}>×</button>
          </div>
        ))}
      </div>
      <dialog ref={dialog} aria-labelledby="question" onCancel={(event) => { event.preventDefault(); asked?.answer(false); }}>
        {asked && (
          <form method="dialog" onSubmit={(event) => { event.preventDefault(); asked.answer(true); }}>
            <h2 id="question">{asked.title}</h2>
            <div class="asked">{asked.text}</div>
            {asked.type && (
              <label>Type <b>{asked.type}</b> to go on
                <input value={typed} autocomplete="off" onInput={(event) => setTyped(event.currentTarget.value)} />
              </label>
            )}
            <footer>
              <button type="button" onClick={() => asked.answer(false)}>Cancel</button>
              <button type="submit" class={asked.destroys ? "destroys" : "primary"}
                      disabled={!!asked.type && typed !== asked.type}>{asked.act}</button>
            </footer>
          </form>
        )}
      </dialog>
    </>
  );
}

// ---- parts of the page that are loaded when they are needed

interface Part<T> {
  load: () => Promise<{default: T}>;
  loaded: T | null;
}

/** \returns null: it has not come yet */
export function useLoaded<T>(part: Part<T>): T | null {
  const [, draw] = useState(0);
  useEffect(() => {
    if (part.loaded) return;
    let ended = false, again = 0;
    const load = (): void => {
      part.load().then((module) => {
        part.loaded = module.default;
        if (!ended) draw((n) => n + 1);
      }, () => { if (!ended) again = window.setTimeout(reload, 2000); });  // the master is away; the frame says so
    };
    // A browser may not ask again for a module that it did not get.
    const reload = (): void => {
      if (known.connected) location.reload();
      else again = window.setTimeout(reload, 2000);
    };
    load();
    return () => { ended = true; clearTimeout(again); };
  }, [part]);
  return part.loaded;
}

// ---- pictures

/** A plot's time in seconds, at least; a single point alone would have years around it. */
const shortestPlot = 60;
/** With fewer points they are seen, because a line needs two of them that are known. */
const fewPoints = 10;
const plots: Part<typeof uPlot> = {load: () => import("./plot"), loaded: null};

function cssColour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** A time series of the last hour. \param at which number of a point, after its time in ms */
export function Series({points, at, label, write}: {
  points: [number, ...(number | null)[]][]; at: number; label: string; write: (value: number) => string;
}) {
  const Plot = useLoaded(plots);
  const box = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const [theme, setTheme] = useState(0);
  useEffect(() => {
    const again = (): void => setTheme((n) => n + 1);
    window.addEventListener("themechange", again);
    return () => window.removeEventListener("themechange", again);
  }, []);
  useLayoutEffect(() => {
    if (!Plot) return;
    const element = box.current!;
    const axis = {stroke: cssColour("--quiet"), grid: {stroke: cssColour("--line"), width: 1}, ticks: {show: false},
                  font: "11px system-ui"};
    const made = new Plot({
      width: element.clientWidth || 300, height: 150, legend: {show: false}, cursor: {y: false},
      scales: {x: {time: true, range: (_, min, max) => (max ? [Math.min(min, max - shortestPlot), max] : [0, shortestPlot])}, y: {range: (_, __, max) => [0, max > 0 ? max * 1.1 : 1]}},
      axes: [{...axis}, {...axis, size: 62, values: (_, splits) => splits.map(write)}],
      series: [{}, {stroke: cssColour("--accent"), width: 1.5, fill: cssColour("--accent-soft"), points: {show: points.length < fewPoints}}],
    }, [[], []], element);
    plot.current = made;
    const watch = new ResizeObserver(() => made.setSize({width: element.clientWidth, height: 150}));
    watch.observe(element);
    return () => { watch.disconnect(); made.destroy(); plot.current = null; };
  }, [theme, Plot, points.length < fewPoints]);
  useEffect(() => {
    plot.current?.setData([points.map((point) => point[0] / 1000), points.map((point) => point[at] ?? null)]);
  });
  const now = points[points.length - 1]?.[at] ?? null;
  return (
    <figure class="series">
      <figcaption>{label} <b>{now === null ? "-" : write(now)}</b></figcaption>
      <div ref={box} role="img" aria-label={`${label} over the last hour, now ${now === null ? "not known" : write(now)}`} />
    </figure>
  );
}

/** The sum of latencies' distributions. */
export function together(latencies: Latency[]): Latency {
  const buckets = new Map<number, number>();
  const sum: Latency = {count: 0, p50_us: 0, p99_us: 0, max_us: 0};
  for (const one of latencies) {
    sum.count += one.count;
    sum.max_us = Math.max(sum.max_us, one.max_us);
    for (const [end, number] of one.buckets ?? []) buckets.set(end, (buckets.get(end) ?? 0) + number);
  }
  const sorted = [...buckets].sort((a, b) => a[0] - b[0]);
  const below = (part: number): number => {
    let seen = 0;
    for (const [end, number] of sorted) if ((seen += number) >= part * sum.count) return Math.min(end, sum.max_us);
    return sum.max_us;
  };
  sum.p50_us = below(0.5);
  sum.p99_us = below(0.99);
  sum.buckets = sorted;
  return sum;
}

/** A distribution of latencies as bars, a quarter of an octave each. */
export function Spread({of, name}: {of: Latency; name: string}) {
  if (!of.count || !of.buckets?.length) return <span class="quiet">-</span>;
  const step = 2 ** 0.25, first = of.buckets[0]![0];
  const place = (end: number): number => Math.round(Math.log(end / first) / Math.log(step));
  const places = place(of.buckets[of.buckets.length - 1]![0]) + 1;
  const most = Math.max(...of.buckets.map(([, number]) => number));
  const width = Math.max(places * 4, 24), height = 26;
  const text = `${name}: half below ${duration(of.p50_us)}, 99 % below ${duration(of.p99_us)}, longest ${duration(of.max_us)}, ${of.count} in all`;
  return (
    <span class="spread" title={text}>
      <svg width={width} height={height} role="img" aria-label={text}>
        {of.buckets.map(([end, number]) => {
          const tall = Math.max(1, (number / most) * height);
          return <rect key={end} x={place(end) * 4} y={height - tall} width="3" height={tall}
                       class={end > of.p99_us ? "tail" : ""} />;
        })}
      </svg>
      <span class="numbers">{duration(of.p50_us)} · {duration(of.p99_us)} · {duration(of.max_us)}</span>
    </span>
  );
}

export function Bar({parts}: {parts: {name: string; number: number}[]}) {
  const all = parts.reduce((sum, part) => sum + part.number, 0);
  if (!all) return null;
  return (
    <div class="bar" role="img" aria-label={parts.map((part) => `${part.number} ${part.name}`).join(", ")}>
      {parts.filter((part) => part.number).map((part) => (
        <span key={part.name} class={`fill-${part.name}`} style={{flexGrow: part.number}} title={`${part.number} ${part.name}`} />
      ))}
    </div>
  );
}

export function Tile({name, value, more, href, bad}: {
  name: string; value: ComponentChildren; more?: ComponentChildren; href?: string; bad?: boolean;
}) {
  const inside = <><span class="name">{name}</span><span class="value">{value}</span><span class="more">{more}</span></>;
  return href ? <a class={bad ? "tile bad" : "tile"} href={href}>{inside}</a>
              : <div class={bad ? "tile bad" : "tile"}>{inside}</div>;
}

export {count};
