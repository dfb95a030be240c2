// What the scripts of this folder share: a browser, checks, pictures, and things that the test does meanwhile.
import {readFile} from "node:fs/promises";
import {createInterface} from "node:readline";

export const options = JSON.parse(process.argv[2]);
const {chromium} = await import(`${options.packages}/playwright-core/index.mjs`);
export const axeFile = `${options.packages}/axe-core/axe.min.js`;

let wrong = 0;
const pages = [];

process.on("uncaughtException", async (error) => {
  console.log(`wrong: ${error.message}\n${error.stack.split("\n").filter((line) => line.includes(".mjs:")).slice(-1)}`);
  for (const page of pages) console.log(`${page.url()}: ${JSON.stringify(page.faults)}`);
  if (pages.length) await pages[pages.length - 1].screenshot({path: `${options.pictures}/failed.png`}).catch(() => undefined);
  process.exit(1);
});

export function check(what, is, more = "") {
  if (is) return;
  wrong++;
  console.log(`wrong: ${what} ${typeof more === "string" ? more : JSON.stringify(more)}`);
}

/** Without the emulation of a GPU, which would draw each frame with more work. */
export const launch = () => chromium.launch({executablePath: options.chromium, args: ["--disable-gpu", ...(options.root ? ["--no-sandbox"] : [])]});

const answers = createInterface({input: process.stdin})[Symbol.asyncIterator]();

/** Lets the test do something, and waits until it is done. */
export async function ask(words) {
  console.log(`DO ${words}`);
  return JSON.parse((await answers.next()).value);
}

/** Waits for what must become true. */
export async function until(what, is, limit_ms = 60_000) {
  const end = Date.now() + limit_ms;
  while (!(await is())) {
    if (Date.now() > end) {
      check(what, false, "in time");
      return false;
    }
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  return true;
}

/** A page whose errors are faults of the test. */
export async function open(browser, more = {}) {
  const context = await browser.newContext({viewport: {width: 1440, height: 900}, acceptDownloads: true, ...more});
  const page = await context.newPage();
  page.faults = [];
  page.setDefaultTimeout(60_000);
  pages.push(page);
  page.on("pageerror", (error) => page.faults.push(error.message));
  page.on("console", (message) => {
    if (message.type() === "error" && /Content.Security|Uncaught/.test(message.text())) page.faults.push(message.text());
  });
  page.on("dialog", (dialog) => { page.faults.push(`a dialog: ${dialog.message()}`); void dialog.dismiss(); });
  return page;
}

export async function logIn(page, url, token) {
  await page.goto(url);
  await page.fill("input[name=token]", token);
  await page.click("button[type=submit]");
  await page.waitForSelector("header.top");
}

/** What axe-core finds in a page or frame, with the rules for WCAG 2 A and AA. It is put there past the page's own policy. */
export async function accessibility(page, what) {
  if (!(await page.evaluate(() => !!window.axe))) await page.evaluate(await readFile(axeFile, "utf8"));
  const found = await page.evaluate(async () => {
    const result = await window.axe.run(document, {runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]});
    return result.violations.map((one) => `${one.id}: ${one.nodes.slice(0, 3).map((node) => node.target.join(" ")).join(", ")}`);
  });
  check(`${what} is accessible`, found.length === 0, found);
}

export async function picture(page, name) {
  await page.screenshot({path: `${options.pictures}/${name}.png`});
}

export async function end(browser) {
  await browser.close();
  console.log(wrong ? `${wrong} faults` : "all is well");
  process.exit(wrong ? 1 : 0);
}
