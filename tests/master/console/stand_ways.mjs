// The console's pages over a made-up fleet: one message's way and its trace file, drops by reason, instances that hang, windows
// and state, and who reads what.
import {readFile} from "node:fs/promises";
import {accessibility, ask, check, picture, until} from "./pages.mjs";

const id = (number) => number.toString(16).padStart(32, "0");

/** Whether it is a file in the Trace Event Format, as Perfetto reads it. \return what is wrong */
export function faultsOfTrace(text) {
  const trace = JSON.parse(text);
  const faults = [];
  if (!Array.isArray(trace.traceEvents) || !trace.traceEvents.length) faults.push("it has no traceEvents");
  const open = new Map(), named = new Set();
  for (const event of trace.traceEvents ?? []) {
    const say = (what) => faults.push(`${what}: ${JSON.stringify(event)}`);
    if (typeof event.name !== "string" || typeof event.ph !== "string" || !Number.isInteger(event.pid) || !Number.isInteger(event.tid)) say("name, ph, pid or tid is missing");
    if (event.ph === "M") {
      named.add(event.pid);
      if (!["process_name", "thread_name"].includes(event.name) || typeof event.args?.name !== "string") say("metadata without a name");
      continue;
    }
    if (!Number.isFinite(event.ts) || event.ts < 0) say("ts is no time");
    if (!named.has(event.pid)) say("its process has no name yet");
    if (event.ph === "X") {
      if (!Number.isFinite(event.dur) || event.dur < 0) say("dur is no duration");
    } else if (event.ph === "b" || event.ph === "e") {
      if (typeof event.id !== "string" || typeof event.cat !== "string") say("an asynchronous event without id or cat");
      const key = `${event.pid} ${event.cat} ${event.id} ${event.name}`;
      open.set(key, (open.get(key) ?? 0) + (event.ph === "b" ? 1 : -1));
    } else {
      say("an unknown phase");
    }
  }
  for (const [key, number] of open) if (number) faults.push(`not ended: ${key}`);
  return faults;
}

/** Saves the page's trace. */
export async function traceOf(page) {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("text=Save as a trace for Perfetto")]);
  return readFile(await download.path(), "utf8");
}

export async function wayAndTroubles(page, url) {
  // ---- one message's way, of a worker on the driver host's machine
  await page.goto(`${url}#/way?gateway=gateway-3&instance=${id(2)}`);
  await until("messages come", async () => (await page.locator("section[aria-label='Last messages'] tbody tr").count()) >= 3);
  const parts = page.locator("section[aria-label='Where the time goes'] tbody tr");
  const texts = await parts.allTextContents();
  const names = ["broker confirms", "broker: to the worker", "kinect: waits", "decode: waits", "commands", "commands: acks later", "broker: back to the driver",
                 "driver: the answer waits", "driver: handles the answer"];
  for (const name of names) check(`the part "${name}" is there`, texts.some((text) => text.includes(name)), texts);
  check("parts come in the order of the way", texts.findIndex((text) => text.includes("kinect: waits")) < texts.findIndex((text) => text.includes("commands")), texts);
  check("a bolt's work is a duration", texts.some((text) => /decode\d*800 µs/.test(text.replace(/\s/g, "").replace("µs", " µs"))), texts);
  check("one machine has one clock", !texts.some((text) => text.includes("two machines")), texts);
  check("the whole loop is summed up", /half within 5\.3 ms/.test(await page.textContent(".acts")), await page.textContent(".acts"));
  check("the way is drawn", (await page.locator("svg.way rect").count()) >= 10);
  await accessibility(page, "a message's way");
  await picture(page, "stand-way");
  const faults = faultsOfTrace(await traceOf(page));
  check("the trace file is one", faults.length === 0, faults);
  await page.click("text=Pause");
  const before = await page.locator("section[aria-label='Last messages'] tbody tr").count();
  await page.locator("section[aria-label='Last messages'] button").last().click();
  check("a message is chosen", (await page.locator("tr.chosen").count()) === 1);
  check("a paused page stands still", (await page.locator("section[aria-label='Last messages'] tbody tr").count()) === before);

  // ---- of a hostile driver, and a worker on another machine
  await page.goto(`${url}#/way?gateway=gateway-2&instance=${id(1)}`);
  await until("the other clock is told", async () => (await page.textContent("main")).includes("difference of two machines' clocks"));
  const notes = await page.locator(".note").allTextContents();
  check("its machine is named", notes.some((note) => note.includes("clock is another one")), notes);
  await until("hostile fates are text", async () => (await page.textContent("main")).includes("dropped: \"><img src=x"));
  check("the hostile trace is one", faultsOfTrace(await traceOf(page)).length === 0);

  // ---- drops by reason
  await page.goto(`${url}#/instance/gateway-3/${id(2)}`);
  await until("drops are told by reason", async () => (await page.textContent("section[aria-label=Channels]")).includes("7 dropped: superseded"));
  check("a hostile reason is text", (await page.textContent("section[aria-label=Channels]")).includes("refused: \"><img"));
  check("what was confirmed is counted", (await page.textContent("section[aria-label=Channels]")).includes("1200"));

  // ---- the overview: hanging and dropping
  await page.goto(`${url}#/overview`);
  await until("what hangs is told", async () => (await page.textContent(".faults")).includes("has not returned since"));
  const hanging = page.locator(".faults li", {has: page.locator(".state-hanging")}), dropping = page.locator(".faults li", {has: page.locator(".state-dropping"), hasText: "on gateway-3"});
  check("what drops is told", (await dropping.textContent()).includes("dropped: superseded"));
  const late = page.locator(".faults li", {hasText: "older than their deadline"});
  await until("a topology's late tuples are told", async () => (await late.count()) === 1 && /\d+ tuples older/.test(await late.textContent()));
  check("a hostile component is text", (await late.textContent()).includes("<script>window.hacked=1</script>"), await late.textContent());
  check("the gateway's own trouble stays its own", (await page.textContent(".faults")).includes("is away since 2026-09-21T14:00:00Z: refused"));
  await hanging.locator("text=Start again").click();
  await until("it is restarted", async () => (await ask("orders")).some((order) => order.order === "restart" && order.with.instances[0] === id(2)));
  await dropping.locator("text=Its channels").click();
  await page.waitForSelector("section[aria-label=Channels]");
  check("the button leads to its channels", page.url().includes(`#/instance/gateway-3/${id(6)}`), page.url());

  // ---- windows, state, and who reads what
  await page.goto(`${url}#/topology/follow`);
  const kept = page.locator("section[aria-label='Windows and state']");
  await until("windows and state are there", async () => (await kept.textContent()).includes("8.0 KB"));
  check("windows of all tasks are summed", (await kept.locator("tr", {hasText: "all"}).textContent()).includes("166"), await kept.textContent());
  const span = page.locator("section[aria-label=Components] select");
  await until("counts of some time ago are there", async () => (await span.locator("option").count()) >= 2);
  const emitted = async () => Number((await page.locator("section[aria-label=Components] tbody tr >> nth=0 >> td >> nth=6").textContent()).replace(" k", "e3"));
  const all = await emitted();
  await span.selectOption({index: 1});
  check("of the last seconds fewer tuples are counted than since the start", (await emitted()) < all, `${await emitted()} ${all}`);
  const stream = (name) => page.locator("section[aria-label=Streams] tbody tr", {has: page.locator("td:first-child", {hasText: "decode"})}).filter({hasText: name});
  const number = async (of) => parseFloat((await of.locator("td").nth(4).textContent()).replace(" k", "e3"));
  await until("each stream has its rate", async () => (await number(stream("default"))) > 3 * (await number(stream("alerts"))) && (await number(stream("alerts"))) > 0);
  check("and its readers", (await stream("alerts").textContent()).includes("commands (all)"));
  check("an edge has its stream's rate", (await page.locator(".graph .edge", {hasText: "alerts"}).textContent()).includes("/s"));
  const input = (bolt, from) => page.locator("section[aria-label='Input stats'] tbody tr", {has: page.locator("td:first-child", {hasText: bolt})}).filter({hasText: from});
  await until("each input has its rate", async () => (await number(input("commands", "script"))) > 3 * (await number(input("commands", "alerts"))) && (await number(input("commands", "alerts"))) > 0);
  const [, , , , , executed, acked] = await input("commands", "alerts").locator("td").allTextContents();
  check("each input has its acks", Number(executed) - Number(acked) === 28, `${executed} ${acked}`);
  const inputs = await page.$$eval("section[aria-label='Input stats'] tbody tr", (rows) => rows.map((row) => [...row.cells].map((cell) => cell.textContent)));
  const of = (bolt) => inputs.find((one) => one[0] === bolt);
  check("a bolt with one input has its own counts", of("decode")[5] === of("decide")[5] && of("decide")[5] !== "0" && of("decide")[1] === "decode", JSON.stringify(inputs));
  await stream("alerts").locator("text=Look").click();
  const message = page.locator(".messages li");
  await until("tuples of one stream are there", async () => (await message.count()) && (await message.first().textContent()).includes("decode alerts"));
  await page.goto(`${url}#/tap?topology=follow&component=kinect`);
  await until("another component's tap is another one", async () => (await message.count()) && (await message.first().textContent()).includes("kinect default"));
  await until("the tap that was left has ended", async () => (await message.count()) && (await message.first().textContent()).includes("taps: 1"));
  check("bytes of a tuple are shown as such", (await message.first().locator(".hex").textContent()) === "89 50 ff" && (await message.first().textContent()).includes("data, 3 B"),
        await message.first().textContent());
  await page.goto(`${url}#/topology/follow`);
  const units = page.locator("section[aria-label='Who reads what']");
  await units.locator("button").click();
  await until("units are there", async () => (await units.textContent()).includes("gateway-1.turtle"));
  check("what is not listed is said", (await units.textContent()).includes("4 more"));
  await accessibility(page, "windows and units");
  await picture(page, "stand-topology");
}
