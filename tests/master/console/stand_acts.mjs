// Each act of the console's pages: what is asked before, and the order that comes of it.
import {ask, check, until} from "./pages.mjs";

const id = (number) => number.toString(16).padStart(32, "0");

/** Says yes to the question. \param typed what must be typed first; empty: nothing. \param words that the question has */
async function yes(page, words, typed = "") {
  await page.waitForSelector("dialog[open]");
  const asked = await page.textContent("dialog");
  for (const word of words) check(`the question has "${word}"`, asked.includes(word), asked);
  const button = page.locator("dialog button[type=submit]");
  check(`"${typed}" must be typed first`, (await button.isDisabled()) === !!typed, asked);
  if (typed) await page.fill("dialog input", typed);
  await button.click();
}

/** Waits for an order. */
const came = (what, is) => until(`the order came: ${what}`, async () => (await ask("orders")).some(is));

export async function acts(page, url) {
  // ---- of gateways
  await page.goto(`${url}#/overview`);
  const fault = (text) => page.locator(".faults li", {hasText: text});
  await page.locator("tbody tr", {hasText: "gateway-1"}).locator("text=Drain").click();
  await yes(page, ["Drain gateway-1?", "takes no new ones"]);
  await came("drain", (order) => order.order === "drain" && order.with.gateways.join() === "gateway-1");
  await fault("gateway-4 drains").locator("text=End draining").click();
  await came("undrain", (order) => order.order === "undrain" && order.with.gateways.join() === "gateway-4");
  await fault("it does not answer the registry").locator("text=Forget").click();
  await yes(page, ["Forget gateway gateway-5?", "orders"], "gateway-5");
  await came("forget", (order) => order.order === "forget" && order.with.gateways.join() === "gateway-5");
  await fault("gateway-2 is frozen").locator("text=Follow the orders").click();
  await yes(page, ["Let gateway-2 follow the registry?", "not ordered"], "gateway-2");
  await came("adopt", (order) => order.order === "adopt" && order.with.gateways.join() === "gateway-2");
  const failed = page.locator(".faults li", {hasText: "the device does not answer"}).first();
  const failedName = await failed.locator("a").first().textContent();
  await failed.locator("text=Start again").click();
  await came(`restart ${failedName}`, (order) => order.order === "restart" && order.with.instances.length === 1);

  // ---- of chosen instances
  await page.goto(`${url}#/fleet?where=${encodeURIComponent(`instance in ["${id(11)}", "${id(12)}"]`)}`);
  await until("two are there", async () => (await page.textContent("#number")) === "2 instances");
  await page.locator(".acts >> text=Choose all 2").click();
  await page.locator(".acts >> text=Stop").click();
  await yes(page, ["Stop 2 instances?", "2 instances on 2 gateways", "meter/11", "robot/12"]);
  await came("stop", (order) => order.order === "stop" && order.with.instances.length === 2);
  await until("both are inactive", async () => (await page.locator(".state-inactive").count()) === 2);
  await page.locator(".acts >> text=Undeploy").click();
  await yes(page, ["Undeploy 2 instances?", "What their driver hosts keep"], "2");
  await came("undeploy", (order) => order.order === "undeploy" && order.with.instances.length === 2);
  await until("both are gone", async () => (await page.textContent("main")).includes("No instance is like that"));

  // ---- of one instance
  await page.goto(`${url}#/instance/gateway-2/${id(13)}`);
  const button = (name) => page.locator(".acts").getByRole("button", {name, exact: true});
  for (const [name, order] of [["Stop", "stop"], ["Start", "start"], ["Restart", "restart"]]) {
    await button(name).click();
    await yes(page, [`${name} meter/13?`]);
    await came(order, (one) => one.order === order && one.with.instances.join() === id(13));
  }
  const describe = page.locator("form", {has: page.locator("text=Key")});
  await describe.locator("input").nth(0).fill("room");
  await describe.locator("input").nth(1).fill("12");
  await describe.locator("button").click();
  await yes(page, ["room=12"]);
  await came("describe", (order) => order.order === "updateMetadata" && order.with.changes.room === "12");
  const update = page.locator("form", {has: page.locator("text=Property")});
  await until("the other plugins are there", async () => (await update.locator("option").count()) === 3 + 2);  // with those of the properties
  await update.locator("select").selectOption({index: 1});
  await update.locator("button").click();
  await yes(page, ["meter-2.so (bbbbbbbbbbbb, version 3"]);
  await came("update", (order) => order.order === "update" && order.with.plugin === "meter-2.so" && order.with.sha256 === "b".repeat(64) &&
    order.with.properties.length === 0);
  check("its manifest is named", (await page.textContent(".facts")).includes('manifest "><img'));
  await button("Undeploy").click();
  await yes(page, ["Undeploy meter/13?"]);
  await came("undeploy of one", (order) => order.order === "undeploy" && order.with.instances.join() === id(13));
  await until("the page leaves what is gone", async () => page.url().endsWith("#/fleet"));

  // ---- of an instance that a rule made
  await page.goto(`${url}#/instance/gateway-2/${id(9)}`);
  await until("its rule is named", async () => (await page.textContent(".facts")).includes('rule "><img'));
  check("what a rule made is not updated by an order", !(await page.locator("text=Property").count()));

  // ---- of a topology
  await page.goto(`${url}#/topology/follow`);
  await page.locator(".acts >> text=Deactivate").click();
  await yes(page, ["Deactivate follow?", "1 worker"]);
  await came("deactivate", (order) => order.change === "deactivate");
  await page.locator(".acts >> text=/^Activate/").click();
  await came("activate", (order) => order.change === "activate");
  await page.locator(".rebalance input").first().fill("4");
  await page.locator(".rebalance button").click();
  await yes(page, ["Rebalance follow?", "decode: 4"]);
  await came("rebalance", (order) => order.change === "rebalance" && order.parallelism.decode === 4);
  await page.locator(".acts >> text=Kill").click();
  await yes(page, ["Kill follow?", "2 tuples pending"], "follow");
  await came("kill", (order) => order.change === "kill");
}
