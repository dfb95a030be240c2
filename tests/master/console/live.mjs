// The console's pages on a live cluster.
import {accessibility, ask, check, end, launch, logIn, open, options, picture, until} from "./pages.mjs";
import {faultsOfTrace, traceOf} from "./stand_ways.mjs";

const browser = await launch();
const {url, tokens} = options;

/** Looks at each page; `name` of the pictures. */
async function tour(page, name) {
  await page.goto(`${url}#/overview`);
  await until("messages and tuples pass, and are timed", async () =>
    (await page.locator(".series figcaption b").allTextContents()).every((text) => /[1-9]/.test(text)), 120_000);
  await page.waitForSelector(".series canvas");
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
  for (const part of ["broker confirms", "broker: to the worker", "receive: waits", "answer", "broker: back to the driver", "driver: handles the answer"])
    await until(`the live way has "${part}"`, async () => (await way.textContent()).includes(part));
  const parts = await way.textContent();
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
  await page.goto(`${url}#/overview`);  // again: now its series are lines
  await page.waitForSelector(".series canvas");
  await picture(page, `overview-${name}`);
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

/** Says yes to the question; what the order came to is told. */
async function yes(told, typed = "") {
  if (typed) await admin.fill("dialog input", typed);
  await admin.locator("dialog button[type=submit]").click();
  await until(`it is told: ${told}`, async () => (await admin.locator(".notice.good", {hasText: told}).count()) > 0);
}
await admin.goto(`${url}#/instance/gateway-1/${instance}`);
const button = (name) => admin.locator(".acts").getByRole("button", {name, exact: true});
await button("Restart").click();
await yes("Restart");
const describe = admin.locator("form", {has: admin.locator("text=Key")});
await describe.locator("input").nth(0).fill("room");
await describe.locator("input").nth(1).fill("12");
await describe.locator("button").click();
await yes("Describe");
await until("its metadata are shown", async () => (await admin.textContent("section[aria-label=Record]")).includes("room12"));
check("a person's order made it", (await admin.textContent("section[aria-label=Record]")).includes("a person's order"));
const update = admin.locator("form", {has: admin.locator("text=Property")});
await until("its gateway's plugins are there", async () => (await update.locator("select").textContent()).includes("replay.so"));
await update.locator("input").nth(0).fill("rate");
await update.locator("input").nth(1).fill("25");
await update.locator("button").click();
await yes("Update");
await until("it has the property", async () => (await admin.textContent("section[aria-label=Record] details")).includes("rate25"));
check("it is active again", (await ask(`state ${instance} gateway-1`)) === "active");
const plugin = await update.locator("option", {hasText: "replay.so"}).getAttribute("value");
await update.locator("select").selectOption(plugin);
await update.locator("button").click();
await admin.locator("dialog button[type=submit]").click();
await admin.locator(".notice.bad", {hasText: "Update"}).locator("button").click();  // it stays until somebody has read it
await until("one that does not come up with another plugin goes back", async () => (await ask(`state ${instance} gateway-1`)) === "active");
await button("Undeploy").click();
await yes("Undeploy");
await until("it is gone", async () => admin.url().endsWith("#/fleet") && (await admin.textContent("#number")) === "5 instances");
await admin.goto(`${url}#/overview`);
await admin.locator("tbody tr", {hasText: "gateway-2"}).locator("text=Drain").click();
await yes("Drain");
await admin.locator(".faults li", {hasText: "gateway-2 drains"}).locator("text=End draining").click();
await until("it drains no longer", async () => (await admin.locator(".faults li", {hasText: "gateway-2 drains"}).count()) === 0);
const refused = await viewer.evaluate(async () => (await fetch("/api/call/order", {
  method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify({order: "drain", with: {gateways: ["gateway-2"]}}),
})).json());
check("an act of a viewer is refused", refused.refused && refused.summary.includes("vera is viewer"), refused);
await admin.goto(`${url}#/topology/echo`);
await admin.locator(".rebalance input").last().fill("1");
await admin.locator(".rebalance button").click();
await yes("Rebalance");
await admin.locator(".acts >> text=Deactivate").click();
await admin.locator("dialog button[type=submit]").click();
await until("the topology is inactive", async () => (await admin.textContent("h1")).includes("inactive"));
await admin.locator(".acts >> text=/^Activate/").click();
await until("the topology is active", async () => !(await admin.textContent("h1")).includes("inactive"));
const audit = await ask("audit");
check("the audit log says who did it", ["stop", "start", "restart", "undeploy", "drain"].every((order) => audit.some((line) => line.who === "anna" && line.what.includes(order))), audit.slice(-4));
await admin.goto(`${url}#/history`);
await until("and so does the page", async () => (await admin.textContent("section[aria-label='Who did what']")).includes("anna"));

// ---- a master that is killed while the page is open

await admin.goto(`${url}#/topology/echo`);
await admin.waitForSelector(".graph .node");
await ask("kill");
await admin.waitForSelector(".banner[role=alert]");
await until("the page goes to the other master", async () => admin.url().startsWith(options.other));
await admin.fill("input[name=token]", tokens.anna);
await admin.click("button[type=submit]");
await admin.waitForSelector(".quiet-banner");
check("and says so", (await admin.textContent(".quiet-banner")).includes(`private-${options.leader} did not answer`), await admin.textContent(".quiet-banner"));
check("at the same page", admin.url().includes("#/topology/echo"), admin.url());
await until("it leads now", async () => (await admin.textContent(".link")).includes("leads"));
await admin.locator(".acts >> text=Kill").click();
await yes("Kill", "echo");
check("the pages had no fault", admin.faults.concat(viewer.faults).length === 0, admin.faults.concat(viewer.faults));

await end(browser);
