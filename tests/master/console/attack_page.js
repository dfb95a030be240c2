// iotcloud page: {"title": "Attacker", "driver": "turtle"}
// A signed page that tries all that a page must not reach, and then what it may ask for. Writes what became of it, for the test.
"use strict";
const site = new URL(location.href).origin === "null" ? location.href.replace(/\/page\/.*/, "") : new URL(location.href).origin;
const results = {};
const shown = document.createElement("pre");
shown.id = "results";
document.body.append(shown);

async function attempt(name, body) {
  try {
    const got = await body();
    results[name] = `got ${String(got)}`;
  } catch (error) {
    results[name] = `refused: ${error.name ?? error}`;
  }
}

/** Resolves when an element or connection has loaded or opened, and rejects when it has failed. */
const outcome = (target) => new Promise((resolve, reject) => {
  target.addEventListener("load", () => resolve("loaded"));
  target.addEventListener("open", () => resolve("opened"));
  target.addEventListener("error", () => reject(new Error("failed")));
});

function add(name, properties) {
  const element = Object.assign(document.createElement(name), properties);
  const ended = outcome(element);
  document.body.append(element);
  return ended;
}

async function attack() {
  await attempt("cookie", () => document.cookie);
  await attempt("local storage", () => localStorage.getItem("theme"));
  await attempt("session storage", () => sessionStorage.length);
  await attempt("database", () => new Promise((resolve, reject) => {
    const request = indexedDB.open("x");
    request.onsuccess = () => resolve("opened");
    request.onerror = () => reject(request.error);
  }));
  await attempt("the console's document", () => parent.document.title);
  await attempt("the console's address", () => parent.location.href);
  await attempt("the element around it", () => { if (!frameElement) throw new Error("none"); return frameElement.id; });
  await attempt("fetch", async () => (await fetch(`${site}/api/me`, {credentials: "include"})).status);
  await attempt("fetch without an answer", async () => (await fetch(`${site}/api/me`, {mode: "no-cors", credentials: "include"})).type);
  await attempt("an order", async () => (await fetch(`${site}/api/call/order`, {method: "POST", body: "{}"})).status);
  await attempt("XMLHttpRequest", () => new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("GET", `${site}/api/me`);
    request.onload = () => resolve(request.status);
    request.onerror = () => reject(new Error("failed"));
    request.send();
  }));
  await attempt("WebSocket", () => outcome(new WebSocket(site.replace("http", "ws"))));
  await attempt("EventSource", () => outcome(new EventSource(`${site}/api/live`)));
  await attempt("a picture of the console", () => add("img", {src: `${site}/icon.svg`}));
  await attempt("a picture of another site", () => add("img", {src: "http://evil.example/picture"}));
  await attempt("a script of the console", () => add("script", {src: `${site}/console.js`}));
  await attempt("a style of another site", () => add("link", {rel: "stylesheet", href: "http://evil.example/style"}));
  await attempt("a script within the page", () => {
    add("script", {textContent: "window.injected = 1"}).catch(() => undefined);
    if (!window.injected) throw new Error("not run");
    return "run";
  });
  await attempt("a handler in HTML", async () => {
    document.body.insertAdjacentHTML("beforeend", "<img src='data:,x' onerror='window.handled = 1'>");
    await outcome(document.body.lastElementChild).catch(() => undefined);
    if (!window.handled) throw new Error("not run");
    return "run";
  });
  await attempt("eval", () => eval("1"));
  await attempt("a worker", () => outcome(new Worker(URL.createObjectURL(new Blob([""], {type: "text/javascript"})))));
  await attempt("a window", () => { const opened = open(`${site}/`); if (!opened) throw new Error("none"); return "opened"; });
  await attempt("the whole window", () => { top.location = "http://evil.example/top"; return "asked"; });
  await attempt("a form", () => {
    const form = Object.assign(document.createElement("form"), {action: `${site}/api/session`, method: "post"});
    document.body.append(form);
    form.submit();
    return "asked";
  });
  await attempt("a frame within", () => new Promise((resolve, reject) => {
    addEventListener("securitypolicyviolation", (event) => reject(new Error(event.effectiveDirective)), {once: true});
    add("iframe", {src: `${site}/`}).then(resolve, reject);
  }));
  navigator.sendBeacon(`${site}/api/session`, "x");
  parent.postMessage({ask: "order", order: "stop", id: 1}, "*");
}

function answersOf(port) {
  const waiting = new Map();
  port.onmessage = ({data}) => waiting.get(data.id)?.(data);
  let last = 0;
  return (asked) => new Promise((resolve) => {
    const id = ++last;
    waiting.set(id, resolve);
    port.postMessage({...asked, id});
  });
}

addEventListener("message", async (event) => {
  if (event.source !== parent || event.data?.iotcloud !== 1) return;
  await attack();
  const ask = answersOf(event.ports[0]);
  const turtle = {gateway: "gateway-4", instance: "00000000000000000000000000000003"};
  const {instances} = await ask({ask: "instances"});
  results.drivers = [...new Set(instances.map((one) => one.gateway))].sort();
  results.keys = Object.keys(instances[0]).sort();
  results.order = (await ask({ask: "order", order: "stop", with: turtle})).problem;
  results.call = (await ask({ask: "__proto__"})).problem;
  results.foreign = (await ask({ask: "tap", gateway: "gateway-2", instance: "00000000000000000000000000000001", channel: "data"})).problem;
  results.wrong = (await ask({ask: "tap", gateway: 7})).problem;
  const {tap} = await ask({ask: "tap", ...turtle, channel: "kinect", depth: true, most: 1});
  const {mm} = tap.messages[0].depth;
  results.sum = mm.reduce((sum, value, i) => (sum + value * (i % 1000)) % 4294967296, 0);
  results.wanted = Number(tap.messages[0].properties.sum);
  results.samples = Array.from({length: 2000}, (_, i) => mm[i * 153]);
  const taps = [];
  for (let i = 0; i < 8; i++) taps.push(ask({ask: "tap", ...turtle, channel: "control"}));
  results.taps = (await Promise.all(taps)).map((answer) => answer.problem).filter(Boolean);
  shown.textContent = JSON.stringify(results);
});
