// The console's pages on a live cluster.
import {accessibility, ask, check, end, launch, logIn, open, options, picture, until} from "./pages.mjs";
import {faultsOfTrace, traceOf} from "./stand_ways.mjs";

const browser = await launch();
const {url, tokens} = options;

/** Looks at each page; `name` of the pictures. */
async function tour(page, name) {
  await page.goto(`${url}#/overview`);
  await until("tuples pass", async () => /[1-9]/.test(await page.textContent(".series figcaption b")), 120_000);
  await page.waitForSelector(".series canvas");
  await picture(page, `overview-${name}`);
  await accessibility(page, `the overview, ${name}`);
  await page.goto(`${url}#/fleet`);
  await until("the instances are there", async () => (await page.textContent("#number")) === "6 instances");
  await picture(page, `fleet-${name}`);
  await page.locator(".rows .line a").first().click();
  await until("rates of channels are there", async () => /\d\s*\d/.test(await page.textContent("section[aria-label=Channels] tbody")) &&
    !(await page.locator("section[aria-label=Channels] td.n").allTextContents()).every((text) => text === "-"));
  await until("the log is there", async () => (await page.textContent(".log")).includes("active"));
  check("the history is there", (await page.textContent("section[aria-label=History]")).includes("starting"));
  await picture(page, `instance-${name}`);
  await page.locator("section[aria-label=Channels] >> text=Look").first().click();
  await page.waitForSelector(".messages li");
  await picture(page, `tap-${name}`);
  await page.goBack();
  await page.locator("section[aria-label=Channels] >> text=Its way").first().click();
  const way = page.locator("section[aria-label='Where the time goes']");
  await until("messages are followed there and back", async () => (await page.locator("section[aria-label='Last messages'] td", {hasText: "yes"}).count()) >= 3);
  const parts = await way.textContent();
  for (const part of ["broker confirms", "broker: to the worker", "receive: waits", "answer", "broker: back to the driver", "driver: handles the answer"])
    check(`the live way has "${part}"`, parts.includes(part), parts);
  check("one machine has one clock", !parts.includes("two machines"), parts);
  const faults = faultsOfTrace(await traceOf(page));
  check("the live trace is one", faults.length === 0, faults.slice(0, 3));
  await accessibility(page, `a message's way, ${name}`);
  await picture(page, `way-${name}`);
  await page.goto(`${url}#/topology/echo`);
  await until("rates of the topology are there", async () => /[1-9][\d.]*\/s/.test(await page.textContent(".graph")));
  check("latencies are distributions", (await page.locator(".spread rect").count()) > 3);
  await page.locator("section[aria-label='Who reads what'] button").click();
  await until("units are there", async () => (await page.locator("section[aria-label='Who reads what'] tbody tr").count()) >= 1);
  await picture(page, `topology-${name}`);
  await accessibility(page, `a topology, ${name}`);
  await page.goto(`${url}#/tap?topology=echo&component=receive`);
  await page.waitForSelector(".messages li");
  await page.goto(`${url}#/history`);
  await page.waitForSelector("tbody tr");
  await picture(page, `history-${name}`);
}

const admin = await open(browser);
await logIn(admin, url, tokens.anna);
await tour(admin, "light");
const viewer = await open(browser, {colorScheme: "dark"});
await logIn(viewer, url, tokens.vera);
await tour(viewer, "dark");

// ---- acts

await admin.goto(`${url}#/fleet?where=${encodeURIComponent('gateway == "gateway-1"')}`);
await until("one gateway's are there", async () => (await admin.textContent("#number")) === "3 instances");
const link = admin.locator(".rows .line a").first();
const instance = await link.getAttribute("title");
await admin.locator(".rows .line input").first().check();
await admin.locator(".acts >> text=Stop").click();
await admin.locator("dialog button[type=submit]").click();
await until("it is stopped", async () => (await ask(`state ${instance} gateway-1`)) === "inactive");
await until("and the page shows it", async () => (await admin.textContent(".rows")).includes("inactive"));
await admin.locator(".acts >> text=Start").click();
await admin.locator("dialog button[type=submit]").click();
await until("it is started", async () => (await ask(`state ${instance} gateway-1`)) === "active");
await admin.goto(`${url}#/topology/echo`);
await admin.locator(".acts >> text=Deactivate").click();
await admin.locator("dialog button[type=submit]").click();
await until("the topology is inactive", async () => (await admin.textContent("h1")).includes("inactive"));
await admin.locator(".acts >> text=/^Activate/").click();
await until("the topology is active", async () => !(await admin.textContent("h1")).includes("inactive"));
const audit = await ask("audit");
check("the audit log says who did it", ["stop", "start"].every((order) => audit.some((line) => line.who === "anna" && line.what.includes(order))), audit.slice(-4));
await admin.goto(`${url}#/history`);
await until("and so does the page", async () => (await admin.textContent("section[aria-label='Who did what']")).includes("anna"));
check("the pages had no fault", admin.faults.concat(viewer.faults).length === 0, admin.faults.concat(viewer.faults));

await end(browser);
