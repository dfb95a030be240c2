// Pages of robots, depth frames in the tap, and the map, over a fleet that is made up.
import {accessibility, ask, check, end, launch, logIn, open, options, picture, until} from "./pages.mjs";

const browser = await launch();
const {url, tokens, instances} = options;
const turtle = "gateway=gateway-4&instance=00000000000000000000000000000003";

/** The frame of a page, when it has its document. */
async function frameOf(page, name) {
  await page.waitForSelector("iframe.robot");
  await until(`the frame of ${name} is there`, async () => page.frames().some((frame) => frame.url().endsWith(`/page/${name}`)));
  return page.frames().find((frame) => frame.url().endsWith(`/page/${name}`));
}

/** Goes to another page of the console; loads all anew, so that nothing of the former page is left. */
async function go(page, path) {
  await page.goto("about:blank");
  await page.goto(url + path);
  await page.waitForSelector("header.top");
}

// ---- which pages there are

const viewer = await open(browser);
let stolen = 0;
await viewer.context().route("http://evil.example/**", (route) => { stolen++; return route.fulfill({body: "evil"}); });
await logIn(viewer, url, tokens.vera);
await viewer.click("nav >> text=Robots");
await viewer.waitForSelector("td >> text=TurtleBot");
const row = (name) => viewer.locator("tbody tr", {hasText: name}).first();
check("the page's signer is shown", (await row("TurtleBot").locator("td").nth(2).textContent()) === "lab");
check("an unsigned page is listed with the reason", (await row("unsigned").textContent()).includes("unsigned.js is not signed"));
check("and without a link", !(await row("unsigned").locator("a").count()));
await accessibility(viewer, "the list of robots' pages");
await go(viewer, "#/robot/unsigned");
await until("the list is connected, too", async () => (await viewer.textContent("header.top")).includes("leads"));
await viewer.waitForSelector(".problem");
check("an unsigned page is not shown", (await viewer.textContent(".problem")).includes("is not signed") && !(await viewer.locator("iframe").count()));
const refused = await viewer.evaluate(async () => { const answer = await fetch("/page/unsigned"); return `${answer.status} ${await answer.text()}`; });
check("and not served", refused.startsWith("400") && refused.includes("not signed"), refused);

// ---- a page that attacks

const answered = [];
viewer.on("response", (response) => {
  if (response.request().frame()?.parentFrame()) answered.push(response.url());
});
await go(viewer, "#/robot/attack");
const attacker = await frameOf(viewer, "attack");
await until("the attacks have ended", async () => (await attacker.textContent("#results")) !== "");
const results = JSON.parse(await attacker.textContent("#results"));
for (const name of ["cookie", "local storage", "session storage", "database", "the console's document", "the console's address",
                    "the element around it", "fetch", "fetch without an answer", "an order", "XMLHttpRequest", "WebSocket", "EventSource",
                    "a picture of the console", "a picture of another site", "a script of the console", "a style of another site",
                    "a script within the page", "a handler in HTML", "eval", "a worker", "a window", "the whole window", "a frame within"])
  check(`a page does not reach: ${name};`, results[name]?.startsWith("refused"), results[name]);
check("nothing but its document was answered", answered.length > 0 && answered.every((one) => one.endsWith("/page/attack")), answered);
check("no order came of it", (await ask("orders")).length === 0);
check("the console is still there", viewer.url().startsWith(url));
check("an order is no ask", /there is no such ask/.test(results.order) && /there is no such ask/.test(results.call), results);
check("another driver's instance is refused", /for instances of turtle/.test(results.foreign), results.foreign);
check("a wrong ask is refused", /is a text/.test(results.wrong), results.wrong);
check("it is told of its driver's instances", results.keys.join() === "gateway,instance,metadata,name,reason,since_ms,state", results.keys);
check("taps are bounded", results.taps.length === 1 && /8 taps/.test(results.taps[0]), results.taps);
check("its depth frames are those of the C++ decoder", results.sum === results.wanted && results.wanted > 0, [results.sum, results.wanted]);

// ---- the same frame in the tap, as a picture

await go(viewer, `#/tap?${turtle}&channel=kinect`);
await viewer.waitForSelector(".depth canvas");
await until("the picture is drawn", async () => (await viewer.textContent(".depth figcaption")).includes("nearest"));
const colours = await viewer.locator(".depth canvas").first().evaluate((canvas) => {
  const {data} = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return Array.from({length: 2000}, (_, i) => [...data.slice(i * 153 * 4, i * 153 * 4 + 3)]);
});
const stops = [[300, 253, 231, 37], [900, 94, 201, 98], [1600, 33, 145, 140], [2600, 59, 82, 139], [4100, 68, 1, 84]];
const colourOf = (mm) => {
  if (!mm) return [0, 0, 0];
  const depth = Math.min(4100, Math.max(300, mm)), after = Math.max(1, stops.findIndex(([at]) => at >= depth));
  const part = (depth - stops[after - 1][0]) / (stops[after][0] - stops[after - 1][0]);
  return [1, 2, 3].map((i) => stops[after - 1][i] + (stops[after][i] - stops[after - 1][i]) * part);
};
const off = results.samples.findIndex((mm, i) => colourOf(mm).some((value, part) => Math.abs(value - colours[i][part]) > 1));
check("each pixel has the colour of its depth", off < 0 && new Set(results.samples).size > 20,
      [off, results.samples[off], colourOf(results.samples[off]), colours[off]]);
await until("pictures go on, a bounded number", async () => (await viewer.locator(".messages li").count()) === 12);
await accessibility(viewer, "depth frames in the tap");
await picture(viewer, "stand-tap-depth");

// ---- a page that leaves

await go(viewer, "#/robot/leaving");
await viewer.waitForSelector("iframe.robot");
await until("the page has tried to leave", async () => viewer.frames().some((frame) => frame.parentFrame() && !frame.url().endsWith("/page/leaving")));
check("nothing reached the other site", stolen === 0, stolen);

// ---- the TurtleBot's page

async function shows(page, name, path) {
  await go(page, path);
  const frame = await frameOf(page, name);
  const fact = (title) => frame.locator(".fact", {hasText: title}).locator("b").textContent();
  await until("distance, latency and commands are there", async () =>
    /^0\.\d\d m$/.test(await fact("Distance")) && /^0\.\d\d ms$/.test(await fact("half below")) && /m\/s/.test(await fact("Forward")));
  await until("the depth picture is there", async () => /nearest 0\.\d\d m/.test(await frame.textContent("figcaption")));
  const where = () => frame.locator("#room").getAttribute("aria-label");
  const first = await where();
  await until("robot and person move", async () => (await where()) !== first && /Robot at .*person at/.test(await where()));
  return frame;
}
await go(viewer, "#/instance/gateway-4/00000000000000000000000000000003");
await viewer.click("text=Its page: TurtleBot");
const own = await frameOf(viewer, "turtlebot");
await until("the page begins with this instance", async () => (await own.inputValue("#instance")) === "gateway-4/00000000000000000000000000000003");
const turtlebot = await shows(viewer, "turtlebot", `#/robot/turtlebot?${turtle}`);
const looks = [];
viewer.on("request", (request) => { if (request.url().endsWith("/look")) looks.push(request.postDataJSON()); });
await accessibility(viewer, "the console around a robot's page");
await accessibility(turtlebot, "the TurtleBot's page");
await until("the paths are long enough for a picture", async () => looks.filter((look) => look.bytes === 0 && look.channel === "kinect").length > 12);
await picture(viewer, "stand-robot-light");
await viewer.click("nav >> text=Overview");
await until("who leaves ends what was sampled", async () => {
  const names = (last) => new Set(looks.filter((look) => !!look.last === last).map((look) => look.look));
  return names(false).size === 3 && [...names(false)].every((name) => names(true).has(name));
});
const dark = await open(browser, {colorScheme: "dark"});
await logIn(dark, url, tokens.anna);
const shown = await shows(dark, "turtlebot", "#/robot/turtlebot");
await accessibility(shown, "the TurtleBot's page in the dark");
await picture(dark, "stand-robot-dark");
await dark.selectOption(".theme select", "light");
await until("the page takes the console's colours", async () => (await shown.locator("html").getAttribute("data-theme")) === "light");
await go(dark, "#/robot/hostile");
const hostile = await frameOf(dark, "hostile");
await until("hostile text is text", async () => (await hostile.textContent("#instance")).includes("<script>window.hacked=1</script>") &&
  (await dark.textContent("h1")).includes("<img src=x"));
for (const frame of dark.frames()) check("no hostile text was run", !(await frame.evaluate(() => window.hacked)));

// ---- a phone

const phone = await open(browser, {viewport: {width: 360, height: 740}, isMobile: true, hasTouch: true});
await logIn(phone, url, tokens.vera);
await go(phone, "#/robot/turtlebot");
const small = await frameOf(phone, "turtlebot");
await until("the phone has the depth picture", async () => /nearest/.test(await small.textContent("figcaption")));
check("the page fits a phone", (await small.evaluate(() => document.documentElement.scrollWidth - innerWidth)) <= 1);
await picture(phone, "stand-robot-phone");

// ---- the map

async function map(page, where) {
  await go(page, `#/fleet${where ? `?where=${encodeURIComponent(where)}` : ""}`);
  await page.waitForSelector(".rows .line");
  await page.click(".search >> text=Map");
  await page.waitForSelector(".map canvas");
}
const land = viewer.waitForResponse((response) => response.url().endsWith("/land.json"));
await map(viewer, "");
check("the outline of the land is a file of the console's own", (await land).ok());
await until("all instances with a place are on it", async () => (await viewer.textContent(".map-words")).startsWith(`${instances / 2} instances of ${instances} at`));
check("a viewer chooses nothing", !(await viewer.locator(".map-acts >> text=Choose").count()));
await accessibility(viewer, "the map");
await picture(viewer, "stand-map-light");
await dark.selectOption(".theme select", "dark");
await map(dark, "");
await until("the map is there in the dark", async () => (await dark.textContent(".map-words")).startsWith(`${instances / 2} `));
await accessibility(dark, "the map in the dark");
const box = await dark.locator(".map canvas").boundingBox();
const drawn = () => dark.locator(".map canvas").evaluate((canvas) => canvas.toDataURL());
const before = await drawn();
await dark.locator(".map canvas").focus();
await dark.keyboard.press("+");
await until("a key zooms", async () => (await drawn()) !== before);
await dark.keyboard.press("0");
await until("and another shows all", async () => (await drawn()) === before);
await dark.click(".map-acts >> text=Choose");
await dark.mouse.move(box.x + 4, box.y + 4);
await dark.mouse.down();
await dark.mouse.move(box.x + box.width - 4, box.y + box.height - 4, {steps: 4});
await picture(dark, "stand-map-dark");
await dark.mouse.up();
await until("what the box has is chosen", async () => (await dark.textContent(".fleet > .acts")).includes(String(instances / 2)));
const third = "0".repeat(31);
await map(dark, `instance in ["${third}4", "${third}6"]`);
await until("both are there", async () => (await dark.textContent(".map-words")).startsWith("2 instances of 2 at 1 place"));
await dark.locator(".map canvas").click();
check("instances at one place are listed", (await dark.locator(".map-stack li").count()) === 2);
await map(dark, `instance == "${third}4"`);
await until("one is there", async () => (await dark.textContent(".map-words")).startsWith("1 instance of 1"));
await dark.locator(".map canvas").click();
await dark.waitForSelector(".facts");
check("a click opens the instance", dark.url().includes(`#/instance/gateway-1/${third}4`), dark.url());

const faults = [dark, phone].flatMap((page) => page.faults);
check("the pages had no fault", faults.length === 0, faults);
check("that of the attacks had none but refusals", viewer.faults.every((text) => /Content.Security/.test(text)), viewer.faults);
await end(browser);
