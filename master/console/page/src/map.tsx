// Instances on a map: points over the outline of the land, which is a file of its own that only the map asks for.
import {useEffect, useLayoutEffect, useRef, useState} from "preact/hooks";
import {get, type Row} from "./api";
import {linkOf} from "./overview";
import {nameOf} from "./fleet";
import {plural} from "./words";

/** A place in degrees. */
interface Place {
  lat: number;
  lon: number;
}

/** Where an instance says that it is: location=LAT,LON, or latitude and longitude, or lat and lon; null: nowhere. */
export function placeOf({metadata}: Row): Place | null {
  const [lat, lon] = metadata["location"]?.split(",") ?? [metadata["latitude"] ?? metadata["lat"], metadata["longitude"] ?? metadata["lon"]];
  if (!lat?.trim() || !lon?.trim()) return null;
  const place = {lat: Number(lat), lon: Number(lon)};
  return Math.abs(place.lat) <= 90 && Math.abs(place.lon) <= 180 ? place : null;
}

// ---- Mercator: the world is one wide, and one high at 85 degrees

const edge = 85.05;
const xOf = (lon: number): number => (lon + 180) / 360;
const yOf = (lat: number): number => {
  const angle = (Math.max(-edge, Math.min(edge, lat)) * Math.PI) / 180;
  return 0.5 - Math.asinh(Math.tan(angle)) / (2 * Math.PI);
};

/** land.json: rings, each its first point and then steps, in tenths of a degree: lon, lat, lon, lat ... */
function pathOf(rings: number[][]): Path2D {
  const path = new Path2D();
  for (const ring of rings) {
    let lon = 0, lat = 0;
    for (let i = 0; i < ring.length; i += 2) {
      lon += ring[i]! / 10;
      lat += ring[i + 1]! / 10;
      if (i) path.lineTo(xOf(lon), yOf(lat));
      else path.moveTo(xOf(lon), yOf(lat));
    }
    path.closePath();
  }
  return path;
}
let land: Promise<Path2D> | null = null;

interface View {
  x: number;       // in the middle
  y: number;
  scale: number;   // pixels that the world is wide
}
const mostScale = 4e7, near = 9;  // pixels around a click

interface Point {
  row: Row;
  key: string;
  x: number;
  y: number;
  state: string;
}
const order = ["inactive", "active", "starting", "failed", "lost"];  // what is wrong is drawn last, above the rest
const paints: Record<string, string> = {active: "--good", failed: "--bad", lost: "--bad", starting: "--cool", deployed: "--cool", stopping: "--cool"};

const within = (low: number, high: number, value: number): number => Math.max(low, Math.min(high, value));

export function WorldMap({rows, lost, chosen, onChoose}: {
  rows: Row[]; lost: Set<string>; chosen: Set<string>; onChoose: ((keys: string[]) => void) | null;
}) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const [outline, setOutline] = useState<Path2D | null>(null);
  const [problem, setProblem] = useState("");
  const [size, setSize] = useState({wide: 0, tall: 0});
  const [view, setView] = useState<View | null>(null);
  const [stack, setStack] = useState<Row[]>([]);
  const [choosing, setChoosing] = useState(false);
  const [box, setBox] = useState<[number, number, number, number] | null>(null);
  const [, drawAgain] = useState(0);
  const drag = useRef<{x: number; y: number; moved: boolean; view: View} | null>(null);
  const points: Point[] = rows.flatMap((row) => {
    const place = placeOf(row);
    return place ? [{row, key: `${row.gateway}/${row.instance}`, x: xOf(place.lon), y: yOf(place.lat), state: lost.has(row.gateway) ? "lost" : row.state}] : [];
  });
  const places = new Set(points.map(({x, y}) => `${x} ${y}`)).size;

  useEffect(() => {
    land ??= get("/land.json").then((answer) => pathOf(answer.rings));
    land.then(setOutline, () => {
      land = null;
      setProblem("the outline of the land could not be loaded; the points are right without it");
    });
    const again = (): void => drawAgain((n) => n + 1);
    window.addEventListener("themechange", again);
    return () => window.removeEventListener("themechange", again);
  }, []);
  useLayoutEffect(() => {
    const element = canvas.current!;
    const measure = (): void => setSize({wide: element.clientWidth, tall: element.clientHeight});
    measure();
    const watch = new ResizeObserver(measure);
    watch.observe(element);
    return () => watch.disconnect();
  }, []);

  /** All points in sight, with a margin; a single place with what is around it. */
  const all = (): View => {
    const bounds = (values: number[]): [number, number] => [Math.min(...values, 1), Math.max(...values, 0)];
    const [left, right] = points.length ? bounds(points.map(({x}) => x)) : [0, 1];
    const [top, bottom] = points.length ? bounds(points.map(({y}) => y)) : [0.2, 0.75];
    const scale = Math.min((size.wide * 0.9) / Math.max(right - left, 1e-4), (size.tall * 0.86) / Math.max(bottom - top, 1e-4));
    return {x: (left + right) / 2, y: (top + bottom) / 2, scale: within(100, mostScale, scale)};
  };
  const shown = view ?? all();
  const toScreen = (x: number, y: number): [number, number] => [(x - shown.x) * shown.scale + size.wide / 2, (y - shown.y) * shown.scale + size.tall / 2];
  const zoom = (factor: number, at: [number, number] = [size.wide / 2, size.tall / 2]): void => {
    const scale = within(Math.max(100, size.wide / 2), mostScale, shown.scale * factor);
    const [dx, dy] = [at[0] - size.wide / 2, at[1] - size.tall / 2];
    setView({x: shown.x + dx / shown.scale - dx / scale, y: shown.y + dy / shown.scale - dy / scale, scale});
  };
  const pan = (dx: number, dy: number, from: View = shown): void =>
    setView({...from, x: within(0, 1, from.x - dx / from.scale), y: within(0, 1, from.y - dy / from.scale)});

  useLayoutEffect(() => {
    const element = canvas.current!, dense = devicePixelRatio || 1;
    if (!size.wide) return;
    element.width = Math.round(size.wide * dense);
    element.height = Math.round(size.tall * dense);
    const context = element.getContext("2d")!;
    const style = getComputedStyle(element);
    const paint = (name: string): string => style.getPropertyValue(name).trim();
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.fillStyle = paint("--ground");
    context.fillRect(0, 0, size.wide, size.tall);
    if (outline) {
      const scale = shown.scale * dense;
      context.fillStyle = paint("--land");
      context.strokeStyle = paint("--line");
      context.lineWidth = 1 / shown.scale;
      for (const turn of [-1, 0, 1]) {  // the world goes on at its edges
        context.setTransform(scale, 0, 0, scale, (size.wide / 2) * dense - (shown.x - turn) * scale, (size.tall / 2) * dense - shown.y * scale);
        context.fill(outline);
        context.stroke(outline);
      }
      context.setTransform(dense, 0, 0, dense, 0, 0);
    }
    const states = [...new Set(points.map(({state}) => state))].sort((a, b) => order.indexOf(a) - order.indexOf(b));
    const radius = points.length > 500 ? 3 : 5;
    for (const state of states) {
      context.beginPath();
      for (const point of points) {
        if (point.state !== state) continue;
        const [x, y] = toScreen(point.x, point.y);
        if (x < -9 || y < -9 || x > size.wide + 9 || y > size.tall + 9) continue;
        context.moveTo(x + radius, y);
        context.arc(x, y, radius, 0, 7);
      }
      context.fillStyle = paint(paints[state] ?? "--quiet");
      context.fill();
    }
    context.beginPath();
    for (const point of points) {
      if (!chosen.has(point.key)) continue;
      const [x, y] = toScreen(point.x, point.y);
      context.moveTo(x + radius + 3, y);
      context.arc(x, y, radius + 3, 0, 7);
    }
    context.strokeStyle = paint("--text");
    context.lineWidth = 1.5;
    context.stroke();
    if (box) {
      context.strokeStyle = paint("--accent");
      context.fillStyle = paint("--accent-soft");
      context.fillRect(box[0], box[1], box[2] - box[0], box[3] - box[1]);
      context.strokeRect(box[0], box[1], box[2] - box[0], box[3] - box[1]);
    }
  });

  const at = (event: MouseEvent): [number, number] => {
    const {left, top} = canvas.current!.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  };
  const inside = ([left, top, right, bottom]: [number, number, number, number]): Point[] => points.filter((point) => {
    const [x, y] = toScreen(point.x, point.y);
    return x >= Math.min(left, right) && x <= Math.max(left, right) && y >= Math.min(top, bottom) && y <= Math.max(top, bottom);
  });
  const down = (event: PointerEvent): void => {
    if (event.button) return;
    const [x, y] = at(event);
    canvas.current!.setPointerCapture(event.pointerId);
    drag.current = {x, y, moved: false, view: shown};
    if (onChoose && (choosing || event.shiftKey)) setBox([x, y, x, y]);
  };
  const move = (event: PointerEvent): void => {
    const from = drag.current, [x, y] = at(event);
    if (!from) return;
    if (Math.hypot(x - from.x, y - from.y) > 4) from.moved = true;
    if (box) setBox([from.x, from.y, x, y]);
    else if (from.moved) pan(x - from.x, y - from.y, from.view);
  };
  const up = (event: PointerEvent): void => {
    const from = drag.current, [x, y] = at(event);
    drag.current = null;
    setBox(null);
    if (!from) return;
    if (box && from.moved) return onChoose?.(inside([from.x, from.y, x, y]).map(({key}) => key));
    if (from.moved) return;
    const hit = inside([x - near, y - near, x + near, y + near]);
    if (hit.length === 1) location.hash = linkOf(hit[0]!.row);
    setStack(hit.length > 1 ? hit.map(({row}) => row) : []);
  };
  const wheel = useRef<(event: WheelEvent) => void>(() => undefined);
  wheel.current = (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY / 400), at(event));
  };
  useEffect(() => {
    const element = canvas.current!, listen = (event: WheelEvent): void => wheel.current(event);
    element.addEventListener("wheel", listen, {passive: false});  // or the page would scroll
    return () => element.removeEventListener("wheel", listen);
  }, []);
  const onKey = (event: KeyboardEvent): void => {
    const steps: Record<string, () => void> = {
      ArrowLeft: () => pan(60, 0), ArrowRight: () => pan(-60, 0), ArrowUp: () => pan(0, 60), ArrowDown: () => pan(0, -60),
      "+": () => zoom(1.5), "=": () => zoom(1.5), "-": () => zoom(1 / 1.5), "0": () => setView(null),
    };
    if (!(event.key in steps)) return;
    steps[event.key]!();
    event.preventDefault();
  };

  return (
    <section class="map" aria-label="Map">
      {problem && <p class="problem" role="alert">{problem}</p>}
      <canvas ref={canvas} tabIndex={0} role="img" class={choosing ? "choosing" : ""}
              aria-label={`Map with ${plural(points.length, "instance")} at ${plural(places, "place")}; the table has the same. Arrows move it, + and - zoom.`}
              onPointerDown={down} onPointerMove={move} onPointerUp={up} onPointerCancel={() => { drag.current = null; setBox(null); }} onKeyDown={onKey} />
      <div class="map-acts" role="group" aria-label="Map's section">
        <button type="button" aria-label="Zoom in" onClick={() => zoom(2)}>+</button>
        <button type="button" aria-label="Zoom out" onClick={() => zoom(0.5)}>−</button>
        <button type="button" onClick={() => setView(null)}>All</button>
        {onChoose && <button type="button" aria-pressed={choosing} title="Drag over instances to choose them; also with Shift" onClick={() => setChoosing(!choosing)}>Choose</button>}
      </div>
      <p class="map-words">{plural(points.length, "instance")} of {rows.length} at {plural(places, "place")}</p>
      {stack.length > 0 && (
        <div class="map-stack" role="dialog" aria-label={`${stack.length} instances here`}>
          <button type="button" aria-label="Close" onClick={() => setStack([])}>×</button>
          <ul>{stack.slice(0, 12).map((row) => (
            <li key={`${row.gateway}/${row.instance}`}><a href={linkOf(row)}>{nameOf(row)}</a> <span class="quiet">{row.driver} on {row.gateway}</span></li>))}
            {stack.length > 12 && <li class="quiet">and {stack.length - 12} more; zoom in</li>}</ul>
        </div>
      )}
    </section>
  );
}
