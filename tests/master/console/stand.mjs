// The console's pages over a fleet that is made up: acts and their refusal, thousands of rows, hostile texts, keyboard, a
// phone, accessibility, and a master that hangs (live.mjs kills one).
import {readFile} from "node:fs/promises";
import {accessibility, ask, check, end, launch, logIn, open, options, picture, until} from "./pages.mjs";

import {acts} from "./stand_acts.mjs";
import {wayAndTroubles} from "./stand_ways.mjs";

const browser = await launch();
const {url, tokens, instances} = options;

// ---- log-in

const admin = await open(browser);
await admin.goto(url);
check("nothing is shown before the log-in", !(await admin.locator("nav").count()));
await accessibility(admin, "the log-in");
await admin.fill("input[name=token]", "anna.wrong");
await admin.click("button[type=submit]");
await admin.waitForSelector("[role=alert]");
check("a wrong token is refused", (await admin.textContent("[role=alert]")).includes("nobody"));
await logIn(admin, url, tokens.anna);
const cookie = (await admin.context().cookies())[0];
check("the session's cookie is out of scripts' reach", cookie.httpOnly && cookie.sameSite === "Strict", cookie);
check("no script sees the cookie", (await admin.evaluate(() => document.cookie)) === "");

// ---- overview

await admin.waitForSelector(".faults li");
check("failed instances are among the faults", (await admin.textContent(".faults")).includes("the device does not answer"));
check("the lost gateway is, too", (await admin.textContent(".faults")).includes("gateway-5"));
await until("the series have points", async () => (await admin.locator(".series figcaption b").allTextContents()).every((text) => !text.startsWith("-")));
const tile = (name) => admin.locator(`.tile:has(.name:text-is("${name}")) .value`).textContent();
check("messages of drivers are told a second", /^[1-9][\d.]*( k)?\/s$/.test(await tile("Messages from drivers")), await tile("Messages from drivers"));
check("so is the round trip of most", (await tile("Round trip")) === "1.3 ms", await tile("Round trip"));
await admin.waitForSelector(".series canvas");
await accessibility(admin, "the overview");

// ---- fleet: thousands of rows

await admin.click("nav >> text=Fleet");
await until("all rows came", async () => (await admin.textContent("#number")) === `${instances} instances`);
const drawn = await admin.locator(".rows .line").count();
check("only rows in sight are drawn", drawn > 10 && drawn < 80, drawn);
await admin.locator(".rows").evaluate((box) => { box.scrollTop = box.scrollHeight; });
await until("the end is reached", async () => (await admin.locator(".rows .line").last().getAttribute("aria-rowindex")) === String(instances + 1));
await admin.fill("[role=search] input", 'state == "failed');
await admin.click("text=Show");
await admin.waitForSelector("#search-problem");
check("a wrong expression is told with its place", (await admin.textContent("#search-problem")).includes("^"));
await admin.fill("[role=search] input", 'state == "failed" and site == "roof"');
await admin.click("text=Show");
await until("the selection is made", async () => /^\d+ instances$/.test(await admin.textContent("#number")) &&
  parseInt(await admin.textContent("#number")) < 20);
check("only selected rows are shown", await admin.locator(".rows .line").evaluateAll((lines) => lines.every((line) => line.textContent.includes("failed"))));
const first = await admin.locator(".rows .line a").first().getAttribute("title");
await admin.locator(".rows .line input").first().check();
await admin.locator(".acts >> text=Start").click();
await admin.waitForSelector("dialog[open]");
check("the question names the instance", (await admin.textContent("dialog")).includes("1 instance on 1 gateway"));
await accessibility(admin, "the question");
await admin.keyboard.press("Escape");
check("nothing is ordered without a yes", (await ask("orders")).length === 0);
await admin.locator(".acts >> text=Start").click();
await admin.locator("dialog button[type=submit]").click();
await until("the order came", async () => (await ask("orders")).some((order) => order.order === "start" && order.with.instances[0] === first));
await until("what was started is selected no longer", async () => !(await admin.locator(`.rows a[title="${first}"]`).count()));
await admin.selectOption("select >> nth=1", "gateway");
await admin.waitForSelector(".line.group");
await accessibility(admin, "the fleet");

// ---- by keyboard

await admin.goto(`${url}#/fleet`);
await until("all rows are back", async () => parseInt(await admin.textContent("#number")) > instances - 9);
await admin.focus(".grid");
await admin.keyboard.press("End");
await until("the End key goes to the end", async () => (await admin.locator(".line.at").getAttribute("aria-rowindex")) > 1000);
await admin.keyboard.press("Home");
await admin.keyboard.press("ArrowDown");
await admin.keyboard.press("Enter");
await admin.waitForSelector(".facts");
check("Enter opens the instance", admin.url().includes("#/instance/"), admin.url());

// ---- one instance, with hostile texts

await admin.goto(`${url}#/instance/gateway-2/00000000000000000000000000000001`);
await admin.waitForSelector(".log");
await until("the log is there", async () => (await admin.textContent(".log")).includes("a line"));
await until("hostile text is text", async () => (await admin.textContent(".facts")).includes("<script>window.hacked=1</script>"));
const update = admin.locator("form", {has: admin.locator("text=Property")});
await update.locator("input").nth(0).fill("rate");
await update.locator("input").nth(1).fill("5");
await update.locator("button").click();
await admin.locator("dialog button[type=submit]").click();
await until("the update came, with the other properties", async () => (await ask("orders")).some((order) =>
  order.order === "update" && order.with.properties[0].properties.rate === "5" && order.with.properties[0].properties.password === "***"));
await accessibility(admin, "an instance");
await admin.goto(`${url}#/tap?gateway=gateway-2&instance=00000000000000000000000000000001&channel=data`);
await until("messages come as JSON, hex and text", async () => {
  const text = await admin.textContent("main");
  return text.includes('"depth"') && text.includes("00 ff 00") && text.includes("<img src=x");
});
await accessibility(admin, "the tap");
await admin.goto(`${url}#/topology/follow`);
await admin.waitForSelector(".graph .node");
check("the graph has all components", (await admin.locator(".graph .node").count()) === 5);
await until("rates are there", async () => /\d\/s/.test(await admin.textContent(".graph")));
check("distributions are drawn", (await admin.locator(".spread rect").count()) > 10);
await accessibility(admin, "a topology");

// ---- history and its export

await admin.goto(`${url}#/history`);
await admin.waitForSelector("tbody tr");
check("a gateway that is silent is named", (await admin.textContent(".problem >> nth=0")).includes("gateway-5"));
await accessibility(admin, "the history");
const [download] = await Promise.all([admin.waitForEvent("download"), admin.click("text=CSV >> nth=0")]);
const csv = await readFile(await download.path(), "utf8");
check("the export has the changes", csv.startsWith("time_ms,gateway,instance") && csv.split("\r\n").length >= 3, csv);
check("a cell is in quotes", csv.includes('"""><img'), csv);
const [other] = await Promise.all([admin.waitForEvent("download"), admin.click("text=JSON >> nth=0")]);
check("and as JSON, with the reason", JSON.parse(await readFile(await other.path(), "utf8"))[0].reason.includes("<img"));
await admin.fill("[role=search] input", "gateway-9");
await until("what does not have the text is hidden", async () => (await admin.textContent("section[aria-label='Changes of state']")).includes("0 changes"));
await admin.fill("[role=search] input", "gateway-1");
await admin.waitForSelector("section[aria-label='Changes of state'] tbody tr");
await admin.locator("input[type=datetime-local]").nth(1).fill("2020-01-01T00:00");
await until("nor what is later", async () => (await admin.textContent("section[aria-label='Changes of state']")).includes("0 changes"));

await wayAndTroubles(admin, url);
await acts(admin, url);

check("no hostile text was run", !(await admin.evaluate(() => window.hacked)));
check("the page had no fault", admin.faults.length === 0, admin.faults);

// ---- a viewer

const viewer = await open(browser, {colorScheme: "dark"});
await logIn(viewer, url, tokens.vera);
await viewer.click("nav >> text=Fleet");
await viewer.waitForSelector(".rows .line");
check("a viewer has no buttons that act", !(await viewer.locator(".acts").count()));
await accessibility(viewer, "the fleet in the dark");
const refused = await viewer.evaluate(async () => (await fetch("/api/call/order", {
  method: "POST", headers: {"Content-Type": "application/json"}, body: JSON.stringify({order: "stop", with: {instances: ["1"]}}),
})).json());
check("an act of a viewer is refused", refused.refused && refused.summary.includes("vera is viewer"), refused);
check("the audit log is not for viewers", (await viewer.evaluate(async () => (await fetch("/api/audit")).status)) === 403);

// ---- another site's page

const evil = await open(browser);
await evil.context().route("http://evil.example/", (route) => route.fulfill({contentType: "text/html", body: "<p>evil</p>"}));
await evil.goto("http://evil.example/");
const stolen = await evil.evaluate(async (to) => {
  try {
    return (await fetch(`${to}api/me`, {credentials: "include"})).status;
  } catch {
    return "blocked";
  }
}, url);
check("a page of another site reads nothing", stolen === "blocked" || stolen === 403, stolen);

// ---- a phone

const phone = await open(browser, {viewport: {width: 360, height: 740}, isMobile: true, hasTouch: true});
await logIn(phone, url, tokens.otto);
const seen = "gateway=gateway-3&instance=00000000000000000000000000000002";
for (const [name, path, has] of [["overview", "", ".faults li"], ["fleet", "#/fleet", ".rows .line"], ["instance", "#/instance/gateway-2/00000000000000000000000000000001", ".log"],
                                 ["topology", "#/topology/follow", ".graph .node"], ["tap", `#/tap?${seen}&channel=data`, ".messages li"],
                                 ["message's way", `#/way?${seen}`, "svg.way"], ["history", "#/history", "tbody tr"]]) {
  await phone.goto(url + path);
  await phone.waitForSelector(has);
  const wide = await phone.evaluate(() => document.documentElement.scrollWidth - innerWidth);
  check(`the ${name} fits a phone`, wide <= 1, `${wide} pixels too wide`);
}
await phone.click(".menu");
check("the menu opens", await phone.locator("nav >> text=Topologies").isVisible());
await picture(phone, "stand-phone");

// ---- an address with a wrong selection

await admin.goto(`${url}#/fleet?where=${encodeURIComponent('state == "failed')}`);
await admin.waitForSelector("#search-problem");
check("a wrong selection in an address is told with its place", (await admin.textContent("#search-problem")).includes("^"));
await until("and takes no other figures away", async () => (await admin.textContent(".link")).includes("master-1"));

// ---- log-out, and a master that hangs

await viewer.click("text=Log out");
await viewer.waitForSelector("input[name=token]");
await admin.goto(`${url}#/fleet`);
await admin.waitForSelector(".rows .line");
await ask("freeze");
await admin.waitForSelector(".banner[role=alert]");
check("a page says that the master is silent", (await admin.textContent(".banner")).includes("does not answer"));
await until("the page goes to the other master", async () => admin.url().startsWith(options.other), 30_000);
await admin.fill("input[name=token]", tokens.anna);
await admin.click("button[type=submit]");
await admin.waitForSelector(".quiet-banner");
check("and says so", (await admin.textContent(".quiet-banner")).includes("master-1 did not answer"));
check("at the same page", admin.url().includes("#/fleet"));

await end(browser);
