// iotcloud page: {"title": "TurtleBot", "driver": "turtle"}
// The TurtleBot's page of the console, and the model of a page for a robot of your own: master/console/README.md says how such a
// page is signed, served and served with data. It is one plain script. It runs in a frame of its own origin, without a session
// and without a network, and asks the console by messages.
"use strict";

// ---- the console, by messages

let port = null;
let lastId = 0;
const waiting = new Map();  // by id: who takes the answers

/** Asks; `take` gets each answer. Returns the id, for end(). */
function ask(what, take) {
  const id = ++lastId;
  waiting.set(id, take);
  port.postMessage({...what, id});
  return id;
}

function end(id) {
  waiting.delete(id);
  port.postMessage({ask: "end", id});
}

addEventListener("message", (event) => {
  if (event.source !== parent || event.data?.iotcloud !== 1 || !event.ports.length) return;
  port = event.ports[0];
  port.onmessage = ({data}) => {
    if (data.event === "theme") return setTheme(data.theme);
    waiting.get(data.id)?.(data);
  };
  setTheme(event.data.theme);
  begin(event.data.query);
});

function setTheme(theme) {
  document.documentElement.dataset.theme = theme;
  colours = null;
  redraw();
}

// ---- what is seen

const style = document.createElement("style");
style.textContent = `
  :root { color-scheme: light; --ground: #fff; --text: #1c2430; --quiet: #566070; --line: #dfe3e8;
          --robot: #0f766e; --person: #b45309; --scan: #64748b; --bad: #b42318; }
  :root[data-theme="dark"] { color-scheme: dark; --ground: #171d25; --text: #e4e8ee; --quiet: #9aa6b5; --line: #2a323d;
          --robot: #2dd4bf; --person: #fbbf24; --scan: #8796a8; --bad: #ff8a80; }
  * { box-sizing: border-box; }
  body { margin: 0; padding: 14px; background: var(--ground); color: var(--text); font: 14px/1.45 system-ui, "Segoe UI", "Noto Sans", sans-serif; }
  header { display: flex; flex-wrap: wrap; gap: 10px 22px; align-items: end; margin-bottom: 12px; }
  label { color: var(--quiet); font-size: 12.5px; display: grid; gap: 2px; }
  select { font: inherit; color: inherit; background: var(--ground); border: 1px solid var(--line); border-radius: 6px;
           padding: 4px 8px; max-width: 300px; }
  .fact { min-width: 86px; }
  .fact span { display: block; color: var(--quiet); font-size: 12.5px; }
  .fact b { font-size: 19px; font-weight: 650; font-variant-numeric: tabular-nums; }
  main { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 14px; }
  @media (max-width: 760px) { main { grid-template-columns: minmax(0, 1fr); } }
  figure { margin: 0; min-width: 0; }
  figcaption { color: var(--quiet); font-size: 12.5px; margin-bottom: 4px; min-height: 18px; }
  canvas { display: block; width: 100%; border: 1px solid var(--line); border-radius: 8px; }
  #depth, #room { aspect-ratio: 4 / 3; max-height: 62vh; }
  #depth { object-fit: contain; }
  #depth { background: #000; }
  #commands, #latency { height: 120px; }
  .key { white-space: nowrap; margin-right: 4px; }
  i { display: inline-block; width: 10px; height: 10px; border-radius: 50%; margin: 0 4px 0 10px; }
  #problem { color: var(--bad); margin: 0 0 10px; }
  #problem:empty { display: none; }`;
document.head.append(style);

/** An element; texts in it are texts, whatever a driver wrote there. */
function make(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

const select = make("select", {id: "instance"});
const values = {}, facts = [];
for (const [name, title] of [["distance", "Distance"], ["rate", "Frames/s"], ["latency", "Latency, half below"], ["slowest", "99 % below"],
                             ["linear", "Forward"], ["angular", "Turn"]]) {
  values[name] = make("b", {textContent: "-"});
  facts.push(make("div", {className: "fact"}, make("span", {textContent: title}), values[name]));
}
const problem = make("p", {id: "problem"});
problem.setAttribute("role", "alert");

function picture(id, ...caption) {
  const canvas = make("canvas", {id});
  canvas.setAttribute("role", "img");
  return {canvas, figure: make("figure", {}, make("figcaption", {}, ...caption), canvas)};
}
/** What a colour means. */
const key = (colour, text) => {
  const mark = make("i");
  mark.style.background = `var(--${colour})`;
  mark.setAttribute("aria-hidden", "true");
  return make("span", {className: "key"}, mark, text);
};
const depthWords = make("span", {textContent: "Depth"}), roomWords = make("span", {textContent: "The room from above"});
const depth = picture("depth", depthWords);
const room = picture("room", roomWords, key("robot", "robot"), key("person", "person"), key("scan", "seen at its camera's height"));
const commands = picture("commands", "Commands of the last 20 s:", key("robot", "forward, m/s"), key("person", "turn, rad/s"));
const latency = picture("latency", "From each frame to its command, ms");
document.documentElement.lang = "en";
document.body.append(make("header", {}, make("label", {}, "Robot", select), ...facts), problem,
                     make("main", {}, depth.figure, room.figure, commands.figure, latency.figure));

let colours = null;
const colour = (name) => {
  if (!colours) {
    const all = getComputedStyle(document.documentElement);
    colours = Object.fromEntries(["ground", "text", "quiet", "line", "robot", "person", "scan"].map((one) => [one, all.getPropertyValue(`--${one}`)]));
  }
  return colours[name];
};

/** A canvas's context with its size in pixels of the page. */
function paper({canvas}) {
  const [wide, tall, dense] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio || 1];
  if (canvas.width !== Math.round(wide * dense) || canvas.height !== Math.round(tall * dense)) {
    canvas.width = Math.round(wide * dense);
    canvas.height = Math.round(tall * dense);
  }
  const context = canvas.getContext("2d");
  context.setTransform(dense, 0, 0, dense, 0, 0);
  context.clearRect(0, 0, wide, tall);
  context.font = "11px system-ui";
  return {context, wide, tall};
}

// ---- what is known of the chosen robot

const keptPoints = 3000, keptCommands = 2000, keptLatencies = 400, shownMs = 20_000, cell = 0.05, mostCells = 20_000;
let seen = null;

function forget() {
  seen = {
    truth: null,          // of the newest frame: [robot x, y, heading, person x, y, distance], metres and radians
    robot: [], person: [],  // paths
    scan: new Map(),      // cells of the floor in which something was seen
    commands: [],         // {at, linear, angular}
    latencies: [],        // {seq, ms}
    mm: null,             // the newest depth frame
    pose: [0, 0, 0],      // by the commands, where there is no truth
    former: null,         // the frames' count at the last look
  };
}
forget();

function addPoint(path, x, y) {
  const last = path[path.length - 1];
  if (last && Math.hypot(x - last[0], y - last[1]) < 0.005) return;
  path.push([x, y]);
  if (path.length > keptPoints) path.shift();
}

/** Numbers of a text "1,2,3"; null: it has others, or another number of them. */
function numbers(text, count) {
  const all = (text ?? "").split(",").map(Number);
  return all.length === count && all.every(Number.isFinite) ? all : null;
}

/** What each frame's message says beside its picture. */
function takeFrames({tap, problem: why}) {
  if (!tap) return say(why);
  say("");
  for (const message of tap.messages) {
    const truth = numbers(message.properties.truth, 6);
    if (truth) {
      seen.truth = truth;
      addPoint(seen.robot, truth[0], truth[1]);
      addPoint(seen.person, truth[3], truth[4]);
    }
    for (const answer of (message.properties.answers ?? "").split(" ").filter(Boolean)) {
      const [seq, us] = answer.split(":").map(Number);
      if (Number.isFinite(seq) && Number.isFinite(us)) seen.latencies.push({seq, ms: us / 1000});
    }
  }
  seen.latencies.splice(0, Math.max(0, seen.latencies.length - keptLatencies));
  if (seen.former && tap.elapsed_us > seen.former.elapsed_us)
    show("rate", ((tap.count - seen.former.count) / ((tap.elapsed_us - seen.former.elapsed_us) / 1e6)).toFixed(1));
  seen.former = tap;
  redraw();
}

function takePicture({tap}) {
  const message = tap?.messages[tap.messages.length - 1];
  if (message?.problem) return say(message.problem);
  if (!message?.depth) return;
  seen.mm = message.depth;
  const truth = numbers(message.properties.truth, 6);
  addScan(message.depth, truth ?? [...seen.pose, NaN, NaN], truth);
  redraw();
}

/** Marks the cells of the floor above which the picture's middle row, at the camera's height, has something. */
function addScan({width, height, mm}, [x, y, heading, personX, personY]) {
  const [c, s] = [Math.cos(heading), Math.sin(heading)];
  for (let u = 0; u < width; u += 4) {
    const z = mm[(height / 2) * width + u] / 1000;
    if (!z || z > 3.5) continue;
    const right = ((u - 320) * z) / 600;
    const [atX, atY] = [x + z * c + right * s, y + z * s - right * c];
    if (Math.hypot(atX - personX, atY - personY) < 0.4) continue;  // who moves is no part of the room
    const key = `${Math.round(atX / cell)},${Math.round(atY / cell)}`;
    seen.scan.set(key, Math.min(8, (seen.scan.get(key) ?? 0) + 1));
  }
  if (seen.scan.size > mostCells) seen.scan.clear();
}

function takeCommands({tap}) {
  for (const message of tap?.messages ?? []) {
    let command;
    try {
      command = JSON.parse(new TextDecoder().decode(message.payload));
    } catch {
      continue;  // the driver ignores it, too, and says so in its log
    }
    const [linear, angular] = [command?.linear?.x, command?.angular?.z];
    if (!Number.isFinite(linear) || !Number.isFinite(angular)) continue;
    const last = seen.commands[seen.commands.length - 1];
    if (last) move(last, Math.min(0.25, Math.max(0, (message.seen_ms - last.at) / 1000)));
    seen.commands.push({at: message.seen_ms, linear, angular});
  }
  seen.commands.splice(0, Math.max(0, seen.commands.length - keptCommands));
}

/** Where the robot would be if it had done what it was told: all that is known of a real one. */
function move({linear, angular}, seconds) {
  const [x, y, heading] = seen.pose, middle = heading + (angular * seconds) / 2;
  seen.pose = [x + linear * seconds * Math.cos(middle), y + linear * seconds * Math.sin(middle), heading + angular * seconds];
  if (!seen.truth) addPoint(seen.robot, seen.pose[0], seen.pose[1]);
}

// ---- drawing

let due = false;
function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    drawDepth();
    drawRoom();
    drawCommands();
    drawLatency();
    showFacts();
  });
}
new ResizeObserver(redraw).observe(document.body);

const show = (name, text) => { values[name].textContent = text; };
const say = (text) => { if (problem.textContent !== (text ?? "")) problem.textContent = text ?? ""; };

function showFacts() {
  const last = seen.commands[seen.commands.length - 1];
  show("distance", seen.truth ? `${seen.truth[5].toFixed(2)} m` : "-");
  show("linear", last ? `${last.linear.toFixed(2)} m/s` : "-");
  show("angular", last ? `${last.angular.toFixed(2)} rad/s` : "-");
  const sorted = seen.latencies.map(({ms}) => ms).sort((a, b) => a - b);
  const at = (part) => (sorted.length ? `${sorted[Math.floor(part * (sorted.length - 1))].toFixed(2)} ms` : "-");
  show("latency", at(0.5));
  show("slowest", at(0.99));
}

/** Near is bright and warm, far is dark and blue, no reading is black. */
const palette = (() => {
  const stops = [[300, 253, 231, 37], [900, 94, 201, 98], [1600, 33, 145, 140], [2600, 59, 82, 139], [4100, 68, 1, 84]];
  const all = new Uint32Array(4101).fill(0xff000000);
  for (let mm = 1; mm < all.length; mm++) {
    const next = Math.max(1, stops.findIndex(([at]) => at >= mm)), [from, to] = [stops[next - 1], stops[next]];
    const part = Math.min(1, Math.max(0, (mm - from[0]) / (to[0] - from[0])));
    const [red, green, blue] = [1, 2, 3].map((i) => Math.round(from[i] + (to[i] - from[i]) * part));
    all[mm] = 0xff000000 | (blue << 16) | (green << 8) | red;
  }
  return all;
})();

function drawDepth() {
  if (!seen.mm) return;
  const {width, height, mm} = seen.mm, {canvas} = depth;
  if (canvas.width !== width) [canvas.width, canvas.height] = [width, height];
  const image = canvas.getContext("2d").createImageData(width, height), pixels = new Uint32Array(image.data.buffer);
  let nearest = 0;
  for (let i = 0; i < pixels.length; i++) {
    pixels[i] = palette[Math.min(mm[i], 4100)];
    if (mm[i] && (!nearest || mm[i] < nearest)) nearest = mm[i];
  }
  canvas.getContext("2d").putImageData(image, 0, 0);
  const words = nearest ? `Depth, 0.3 m (bright) to 4 m; nearest ${(nearest / 1000).toFixed(2)} m` : "Depth: no pixel has a reading";
  depthWords.textContent = words;
  canvas.setAttribute("aria-label", words);
}

function drawRoom() {
  const {context, wide, tall} = paper(room);
  const cells = [...seen.scan].filter(([, times]) => times > 1).map(([key]) => key.split(",").map((part) => part * cell));
  const [x, y, heading] = seen.truth ?? seen.pose;
  const all = [[x - 1.5, y - 1.5], [x + 1.5, y + 1.5], ...seen.robot, ...seen.person, ...cells];
  const bounds = (i) => [Math.min(...all.map((p) => p[i])) - 0.3, Math.max(...all.map((p) => p[i])) + 0.3];
  const [[left, right], [low, high]] = [bounds(0), bounds(1)];
  const scale = Math.min(wide / (right - left), tall / (high - low));
  const place = ([px, py]) => [wide / 2 + (px - (left + right) / 2) * scale, tall / 2 - (py - (low + high) / 2) * scale];
  context.strokeStyle = colour("line");
  context.fillStyle = colour("quiet");
  context.lineWidth = 1;
  context.beginPath();
  for (let at = Math.ceil(Math.min(left, low) - 9); at < Math.max(right, high) + 9; at++) {
    const [px, py] = place([at, at]);
    context.moveTo(px, 0);
    context.lineTo(px, tall);
    context.moveTo(0, py);
    context.lineTo(wide, py);
  }
  context.stroke();
  context.fillText("grid: 1 m", 8, tall - 8);
  context.fillStyle = colour("scan");
  for (const point of cells) {
    const [px, py] = place(point);
    context.fillRect(px - (cell * scale) / 2, py - (cell * scale) / 2, cell * scale, cell * scale);
  }
  const path = (points, name) => {
    context.strokeStyle = colour(name);
    context.lineWidth = 2;
    context.beginPath();
    points.forEach((point, i) => (i ? context.lineTo(...place(point)) : context.moveTo(...place(point))));
    context.stroke();
  };
  path(seen.person, "person");
  path(seen.robot, "robot");
  if (seen.truth) {
    context.fillStyle = colour("person");
    context.beginPath();
    context.arc(...place([seen.truth[3], seen.truth[4]]), Math.max(5, 0.12 * scale), 0, 7);
    context.fill();
  }
  const [px, py] = place([x, y]), size = Math.max(7, 0.18 * scale), edge = Math.atan(320 / 600);
  context.fillStyle = colour("robot");
  context.globalAlpha = 0.16;  // what the camera sees
  context.beginPath();
  context.moveTo(px, py);
  context.arc(px, py, scale * 1.2, -heading - edge, -heading + edge);
  context.fill();
  context.globalAlpha = 1;
  context.beginPath();
  context.arc(px, py, size, 0, 7);
  context.fill();
  context.strokeStyle = colour("ground");
  context.lineWidth = 3;
  context.beginPath();
  context.moveTo(px, py);
  context.lineTo(px + size * Math.cos(heading), py - size * Math.sin(heading));
  context.stroke();
  roomWords.textContent = seen.truth ? "From above, by the simulation:" : "From above, by its commands:";
  room.canvas.setAttribute("aria-label", `Robot at ${x.toFixed(1)}, ${y.toFixed(1)} m` +
    (seen.truth ? `, person at ${seen.truth[3].toFixed(1)}, ${seen.truth[4].toFixed(1)} m` : ", by its commands"));
}

/** Lines of values over time, all within `most` of zero. */
function drawCommands() {
  const {context, wide, tall} = paper(commands);
  const now = seen.commands.length ? seen.commands[seen.commands.length - 1].at : 0;
  const shown = seen.commands.filter(({at}) => now - at < shownMs);
  const most = Math.max(0.5, ...shown.map(({linear, angular}) => Math.max(Math.abs(linear), Math.abs(angular)))) * 1.1;
  const place = (at, value) => [wide - ((now - at) / shownMs) * wide, tall / 2 - (value / most) * (tall / 2)];
  context.strokeStyle = colour("line");
  context.beginPath();
  context.moveTo(0, tall / 2);
  context.lineTo(wide, tall / 2);
  context.stroke();
  context.fillStyle = colour("quiet");
  context.fillText(`+${most.toFixed(1)}`, 6, 13);
  context.fillText(`-${most.toFixed(1)}`, 6, tall - 6);
  for (const [key, name] of [["angular", "person"], ["linear", "robot"]]) {
    context.strokeStyle = colour(name);
    context.lineWidth = 1.5;
    context.beginPath();
    shown.forEach((one, i) => (i ? context.lineTo(...place(one.at, one[key])) : context.moveTo(...place(one.at, one[key]))));
    context.stroke();
  }
  const last = shown[shown.length - 1];
  commands.canvas.setAttribute("aria-label", last ? `Last command: ${last.linear.toFixed(2)} m/s, ${last.angular.toFixed(2)} rad/s` : "No command yet");
}

function drawLatency() {
  const {context, wide, tall} = paper(latency), all = seen.latencies;
  const most = Math.max(1, ...all.map(({ms}) => ms)) * 1.1, first = all[0]?.seq ?? 0, last = all[all.length - 1]?.seq ?? 1;
  const place = ({seq, ms}) => [8 + ((seq - first) / Math.max(1, last - first)) * (wide - 16), tall - 4 - (ms / most) * (tall - 20)];
  context.fillStyle = colour("quiet");
  context.fillText(`${most.toFixed(1)} ms`, 6, 13);
  context.fillStyle = colour("robot");
  for (const [x, y] of all.map(place)) context.fillRect(x - 1.5, y - 1.5, 3, 3);
  latency.canvas.setAttribute("aria-label", `Latency of ${all.length} frames, at most ${Math.max(0, ...all.map(({ms}) => ms)).toFixed(1)} ms`);
}

// ---- which robot

let taps = [], chosen = "";
const keyOf = ({gateway, instance}) => `${gateway}/${instance}`;

function begin(query) {
  if (query.instance) chosen = `${query.gateway}/${query.instance}`;
  ask({ask: "instances"}, ({instances}) => {
    const known = new Map(instances.map((one) => [keyOf(one), one]));
    const words = (one) => `${one.name || one.instance.slice(0, 8)} on ${one.gateway} (${one.state})`;
    select.replaceChildren(...instances.map((one) => make("option", {value: keyOf(one), textContent: words(one)})));
    if (!instances.length) say("No turtle is deployed. Try: iotcloud deploy turtle.so --gateway GATEWAY");
    const next = known.has(chosen) ? chosen : instances.length ? keyOf(instances[0]) : "";
    select.value = next;
    if (next !== chosen || !taps.length) choose(next);
  });
}

function choose(key) {
  for (const id of taps) end(id);
  taps = [];
  chosen = key;
  forget();
  redraw();
  if (!key) return;
  const [gateway, instance] = key.split(/\/(?=[^/]*$)/);
  const tap = (channel, more, take) => ask({ask: "tap", gateway, instance, channel, ...more}, take);
  taps = [tap("kinect", {bytes: 0, most: 64, per_second: 4}, takeFrames),
          tap("kinect", {depth: true, most: 1, per_second: 5}, takePicture),
          tap("control", {most: 64, per_second: 4}, takeCommands)];
}
select.addEventListener("change", () => choose(select.value));
