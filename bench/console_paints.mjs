// Prints what N new browser profiles take, in ms, as a JSON object of lists: `overview`, from the navigation until the overview's
// figures are painted. With WHERE: of the fleet's page with all ROWS instances, `rows`, from the navigation until its first rows
// are painted and all are known; `scroll`, from a jump to another place until its rows are painted; `filter`, from the order to show
// those that WHERE selects until they are.
// usage: node console_paints.mjs NODE_MODULES URL N [ROWS WHERE FOUND]
const [packages, url, number, rows, where, found] = process.argv.slice(2);
const {chromium} = await import(`${packages}/playwright-core/index.mjs`);
const browser = await chromium.launch({executablePath: "/usr/bin/chromium", args: process.getuid() === 0 ? ["--no-sandbox"] : []});
const jumps = 10;
const all = where ? {rows: [], scroll: [], filter: []} : {overview: []};

/** In the page: `painted(is)` ends, with the time, when `is()` holds and a frame has been painted since. */
const watcher = () => {
  window.painted = (is) => new Promise((resolve) => {
    const look = () => {
      if (!is()) return false;
      requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now())));
      return true;
    };
    if (look()) return;
    const watch = new MutationObserver(() => { if (look()) watch.disconnect(); });
    watch.observe(document, {childList: true, subtree: true, characterData: true, attributes: true});
  });
};

async function overview(page) {
  await page.addInitScript(() => { window.first = window.painted(() => document.querySelector(".tile .value")); });
  await page.goto(url);
  all.overview.push(await page.evaluate(() => window.first));
}

async function fleet(page) {
  await page.addInitScript((text) => {
    window.first = window.painted(() => document.querySelector("#number")?.textContent === text && document.querySelector(".rows .line"));
  }, `${rows} instances`);
  await page.goto(`${url}#/fleet`);
  all.rows.push(await page.evaluate(() => window.first));
  for (let i = 1; i <= jumps; i++) {
    all.scroll.push(await page.evaluate(async (part) => {
      const box = document.querySelector(".rows"), begun = performance.now();
      const wanted = Math.floor((box.scrollHeight - box.clientHeight) * part);
      box.scrollTop = wanted;
      return await window.painted(() => [...document.querySelectorAll(".rows .line")].some((line) => {
        const top = line.getBoundingClientRect().top - box.getBoundingClientRect().top;
        return top >= 0 && top < box.clientHeight;
      })) - begun;
    }, (i * 7 % (jumps + 1)) / jumps));
  }
  all.filter.push(await page.evaluate(async ([expression, text]) => {
    const begun = performance.now();
    location.hash = `#/fleet?where=${encodeURIComponent(expression)}`;
    return await window.painted(() => document.querySelector("#number")?.textContent === text) - begun;
  }, [where, found]));
}

for (let i = 0; i < Number(number); i++) {
  const context = await browser.newContext();
  const page = await context.newPage();
  await page.addInitScript(watcher);
  await (where ? fleet : overview)(page);
  await context.close();
}
await browser.close();
console.log(JSON.stringify(all));
