// The demo's robot on its page.
import {accessibility, check, end, launch, open, options, picture, until} from "./pages.mjs";

const browser = await launch();

async function shows(name, colorScheme) {
  const page = await open(browser, {colorScheme});
  await page.goto(options.url);
  await page.click("nav >> text=Robots");
  await page.click("td >> text=TurtleBot");
  await page.waitForSelector("iframe.robot");
  await until("the page's frame is there", async () => page.frames().some((frame) => frame.url().endsWith("/page/turtlebot")));
  const frame = page.frames().find((one) => one.url().endsWith("/page/turtlebot"));
  const place = async () => (await frame.locator("#room").getAttribute("aria-label"))?.match(/Robot at (-?[\d.]+), (-?[\d.]+) m, person at/)?.slice(1).map(Number);
  const fact = async (title) => parseFloat(await frame.locator(".fact", {hasText: title}).locator("b").textContent());
  await until("the simulation's truth is there", async () => await place());
  const first = await place();
  await until("the robot follows for a metre", async () => {
    const [x, y] = await place();
    return Math.hypot(x - first[0], y - first[1]) > 1;
  }, 300_000);
  await until("400 frames have their latencies", async () => /of 400 frames/.test(await frame.locator("#latency").getAttribute("aria-label")));
  const distance = await fact("Distance"), latency = await fact("half below");
  check("the distance is one at which a person is followed", distance > 0.4 && distance < 1.2, distance);
  check("the latency is one", latency > 0, latency);
  check("frames come", (await fact("Frames/s")) > 1);
  check("the depth picture is there", /nearest \d\.\d\d m/.test(await frame.textContent("figcaption")));
  await accessibility(frame, `the robot's page, ${name}`);
  await picture(page, `${options.name}-${name}`);
  await page.goto(`${options.url}#/tap?topology=turtlebot_follower&component=kinect_receive`);
  const tuple = page.locator(".messages li");
  await until("a stream's depth frames are pictures", async () => /nearest \d\.\d\d m/.test((await tuple.count()) ? await tuple.first().textContent() : ""));
  check("the page had no fault", page.faults.length === 0, page.faults);
  await page.context().close();
}

await shows("light", "light");
await shows("dark", "dark");
await end(browser);
