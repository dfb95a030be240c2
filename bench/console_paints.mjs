// Prints how many ms each of N new browser profiles took from the navigation until the overview's figures were painted, as a
// JSON list.
// usage: node console_paints.mjs NODE_MODULES URL N
const [packages, url, number] = process.argv.slice(2);
const {chromium} = await import(`${packages}/playwright-core/index.mjs`);
const browser = await chromium.launch({executablePath: "/usr/bin/chromium", args: process.getuid() === 0 ? ["--no-sandbox"] : []});
const all = [];
for (let i = 0; i < Number(number); i++) {
  const context = await browser.newContext();
  const page = await context.newPage();
  await page.addInitScript(() => {
    window.painted = new Promise((resolve) => {
      const watch = new MutationObserver(() => {
        if (!document.querySelector(".tile .value")) return;
        watch.disconnect();
        requestAnimationFrame(() => requestAnimationFrame(() => resolve(performance.now())));
      });
      watch.observe(document, {childList: true, subtree: true});
    });
  });
  await page.goto(url);
  all.push(await page.evaluate(() => window.painted));
  await context.close();
}
await browser.close();
console.log(JSON.stringify(all));
