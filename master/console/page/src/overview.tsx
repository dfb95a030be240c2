// What is there, how much passes, and what is wrong.
import type {ComponentChildren} from "preact";
import type {Gateway, Loss, Row} from "./api";
import {Bar, confirm, Empty, isAdmin, mayAct, order, Panel, Series, State, Tile, useKnown} from "./parts";
import {age, count, duration, plural, short} from "./words";

const states = ["active", "starting", "deployed", "ordered", "stopping", "inactive", "failed", "lost", "undeployed"];

interface Fault {
  key: string;
  what: ComponentChildren;
  why: string;
  since?: number;
  buttons?: ComponentChildren;
}

export const linkOf = (row: {gateway: string; instance: string}): string =>
  `#/instance/${encodeURIComponent(row.gateway)}/${encodeURIComponent(row.instance)}`;

async function startAgain(row: Row): Promise<void> {
  await order(`Restart ${row.name || short(row.instance)}`, "restart", {instances: [row.instance], gateways: [row.gateway]});
}

function faultOf(row: Row): Fault {
  return {
    key: `${row.gateway}/${row.instance}`,
    what: <><State of={row.state} lost={row.lost} /> <a href={linkOf(row)}>{row.name || short(row.instance)}</a>
      <span class="quiet"> {row.driver} on {row.gateway}</span></>,
    why: row.lost ? `its gateway ${row.gateway} is lost; its state was: ${row.state}` : row.reason,
    since: row.since_ms,
    buttons: mayAct() && !row.lost && (
      <button type="button" onClick={() => void startAgain(row)}>Start again</button>
    ),
  };
}

/** An instance that hangs or drops messages, as its gateway says (gateway/fleet/host_troubles.h). */
interface Trouble {
  instance: string;
  what: "hangs" | "drops messages";
  why: string;
}

/** Takes apart what a gateway says: about itself, and about its instances. */
function troubleOf(gateway: Gateway): {own: string; instances: Trouble[]} {
  const own: string[] = [], instances: Trouble[] = [];
  for (const part of (gateway.trouble ?? "").split("; ")) {
    const found = /^instance (\S+) (hangs|drops messages): (.*)$/s.exec(part);
    if (found) instances.push({instance: found[1]!, what: found[2] as Trouble["what"], why: found[3]!});
    else if (part) own.push(part);
  }
  return {own: own.join("; "), instances};
}

function instanceFault(gateway: string, trouble: Trouble): Fault {
  const hangs = trouble.what === "hangs";
  const link = linkOf({gateway, instance: trouble.instance});
  return {
    key: `${trouble.what} ${gateway}/${trouble.instance} ${trouble.why}`,
    what: <><State of={hangs ? "hanging" : "dropping"} /> <a href={link}>{short(trouble.instance)}</a><span class="quiet"> on {gateway}</span></>,
    why: trouble.why,
    buttons: hangs ? mayAct() && <button type="button" onClick={() => void order(`Restart ${short(trouble.instance)}`, "restart", {instances: [trouble.instance], gateways: [gateway]})}>Start again</button>
      : <a class="button" href={link}>Its channels</a>,
  };
}

const lossWords: [keyof Loss["counts"], string][] = [["late", "older than their deadline, not executed"], ["timed_out", "timed out"], ["failed", "failed"]];

/** A component of a topology whose tuples are late or fail. */
function lossFault(loss: Loss): Fault {
  const {counts} = loss, {errors} = counts;
  const why = lossWords.filter(([key]) => counts[key]).map(([key, text]) => `${plural(counts[key]!, "tuple")} ${text}`);
  if (errors) why.push(plural(errors, "error"));
  const link = `#/topology/${encodeURIComponent(loss.topology)}?component=${encodeURIComponent(loss.component)}`;
  return {
    key: `lost ${loss.topology} ${loss.component}`,
    what: <><State of="dropping" /> <a href={link}>{loss.component}</a><span class="quiet"> in topology {loss.topology}</span></>,
    why: why.join("; "),
    since: loss.since_ms,
    buttons: <a class="button" href={link}>Its tasks</a>,
  };
}

export function Overview() {
  const {state, points, messages} = useKnown();
  if (!state) return <Empty>The master is looking at the fleet ...</Empty>;
  const {master, gateways, topologies, counts} = state;
  const alive = gateways.filter((gateway) => gateway.alive).length;
  const workers = topologies.reduce((sum, topology) => sum + topology.workers.length, 0);
  const faults: Fault[] = [];
  const late: Fault[] = [];     // after those that do nothing at all
  const planned: Fault[] = [];  // what people ordered comes last
  if (!master.leading && !master.leader) faults.push({key: "leader", what: <b>No master leads</b>, why: "orders are refused until one is elected"});
  for (const gateway of gateways) {
    const own = {gateways: [gateway.gateway]};
    if (!gateway.alive) {
      faults.push({
        key: `lost ${gateway.gateway}`,
        what: <><State of="lost" /> gateway <b>{gateway.gateway}</b> <span class="quiet">on {gateway.host}</span></>,
        why: "it does not answer the registry; its orders wait for it",
        since: gateway.since_ms,
        buttons: isAdmin() && (
          <button type="button" class="destroys" onClick={async () => {
            const there = state.faults.filter((row) => row.gateway === gateway.gateway && row.lost).length;
            if (await confirm({
              title: `Forget gateway ${gateway.gateway}?`, act: "Forget it", destroys: true, type: gateway.gateway,
              text: <p>Its record, its orders and those of its {there >= 100 ? "100 or more" : there} instances are removed from the
                registry. If it comes back, it undeploys what it runs.</p>,
            })) void order(`Forget ${gateway.gateway}`, "forget", own);
          }}>Forget</button>
        ),
      });
    }
    const {own: trouble, instances} = troubleOf(gateway);
    if (trouble) late.push({key: `trouble ${gateway.gateway}`, what: <>gateway <b>{gateway.gateway}</b></>, why: trouble});
    for (const one of instances) late.push(instanceFault(gateway.gateway, one));
    if (gateway.frozen) {
      faults.push({
        key: `frozen ${gateway.gateway}`,
        what: <>gateway <b>{gateway.gateway}</b> is frozen</>,
        why: `${gateway.frozen}; when the orders in the registry are as they should be, let it follow them`,
        buttons: isAdmin() && (
          <button type="button" onClick={async () => {
            if (await confirm({
              title: `Let ${gateway.gateway} follow the registry?`, act: "Follow it", destroys: true, type: gateway.gateway,
              text: <p>It undeploys the instances that are not ordered. Look at the orders first.</p>,
            })) void order(`Adopt ${gateway.gateway}`, "adopt", own);
          }}>Follow the orders</button>
        ),
      });
    }
    if (gateway.draining) {
      planned.push({
        key: `draining ${gateway.gateway}`, what: <>gateway <b>{gateway.gateway}</b> drains</>,
        why: "its instances are stopped, and it takes no new ones",
        buttons: mayAct() && <button type="button" onClick={() => void order(`Undrain ${gateway.gateway}`, "undrain", own)}>End draining</button>,
      });
    }
  }
  for (const topology of topologies) {
    const to = <a href={`#/topology/${encodeURIComponent(topology.name)}`}>topology {topology.name}</a>;
    if (topology.wanted === "active" && !topology.workers.length)
      faults.push({key: `idle ${topology.name}`, what: to, why: "it is to be active, and no worker runs it"});
    for (const worker of topology.workers) {
      for (const why of [worker.trouble, worker.error]) {
        if (why) {
          faults.push({key: `${worker.name} ${why}`, what: <>{to} <span class="quiet">worker {worker.name} on {worker.host}</span></>, why,
                       buttons: <a class="button" href={`#/topology/${encodeURIComponent(topology.name)}`}>Its page</a>});
        }
      }
    }
  }
  faults.push(...state.faults.map(faultOf), ...late, ...(state.losses ?? []).map(lossFault), ...planned);
  const parts = states.map((name) => ({name, number: counts[name] ?? 0}));
  const last = points[points.length - 1], carried = messages[messages.length - 1];
  return (
    <>
      <h1>Overview</h1>
      <div class="tiles">
        <Tile name="Leader" value={master.leading ? master.id : master.leader || "none"} bad={!master.leading && !master.leader}
              more={master.leading ? `this master, epoch ${master.epoch}` : `this is ${master.id}, on standby`} />
        <Tile name="Gateways" value={`${alive} of ${gateways.length}`} bad={alive < gateways.length}
              more={plural(new Set(gateways.map((gateway) => gateway.host)).size, "host")} href="#/fleet" />
        <Tile name="Instances" value={count(state.instances)} bad={!!state.number_of_faults} href="#/fleet"
              more={parts.filter((part) => part.number).map((part) => `${part.number} ${part.name}`).join(", ") || "none"} />
        <Tile name="Topologies" value={topologies.length} more={plural(workers, "worker")} href="#/topology" />
        <Tile name="Messages from drivers" value={carried?.[1] != null ? `${count(carried[1])}/s` : "-"}
              more={carried?.[2] != null ? `${count(carried[2])}/s to them` : "not known yet"} />
        <Tile name="Round trip" value={carried?.[3] != null ? duration(carried[3]) : "-"}
              more={carried?.[3] != null ? "99 % of drivers' messages are answered within" : "no driver is answered now"} />
        <Tile name="Tuples from spouts" value={last ? `${count(last[1])}/s` : "-"}
              more={last?.[2] != null ? `99 % are done within ${duration(last[2])}` : "no topology reads now"} />
      </div>
      <Bar parts={parts} />
      <Panel title="What is wrong" more={<span class="quiet">{faults.length ? plural(faults.length - state.faults.length + state.number_of_faults, "fault") : ""}</span>}>
        {faults.length === 0 ? <Empty>Nothing that the master knows of.</Empty> : (
          <ul class="faults">
            {faults.map((fault) => (
              <li key={fault.key}>
                <div>{fault.what}<p>{fault.why || "no reason was given"}{fault.since ? <span class="quiet"> · {age(fault.since)}</span> : ""}</p></div>
                <div class="buttons">{fault.buttons}</div>
              </li>
            ))}
            {state.number_of_faults > state.faults.length && (
              <li><a href={counts["lost"] ? "#/fleet" : `#/fleet?where=${encodeURIComponent('state == "failed"')}`}>
                and {state.number_of_faults - state.faults.length} more instances</a></li>
            )}
          </ul>
        )}
      </Panel>
      <div class="two">
        <Panel title="Messages a second">
          <Series points={messages} at={1} label="From all drivers" write={(value) => `${count(value)}/s`} />
        </Panel>
        <Panel title="From a driver and back to it">
          <Series points={messages} at={3} label="99 % below" write={duration} />
        </Panel>
        <Panel title="Tuples a second">
          <Series points={points} at={1} label="From all spouts" write={(value) => `${count(value)}/s`} />
        </Panel>
        <Panel title="From spout to last bolt">
          <Series points={points} at={2} label="99 % below" write={duration} />
        </Panel>
      </div>
      <Panel title="Gateways">
        <div class="scroll">
          <table>
            <thead><tr><th>Gateway</th><th>State</th><th>Host</th><th>Brokers</th><th>Since</th><th><span class="hidden">Acts</span></th></tr></thead>
            <tbody>
              {gateways.map((gateway) => (
                <tr key={gateway.gateway}>
                  <td><a href={`#/fleet?where=${encodeURIComponent(`gateway == ${JSON.stringify(gateway.gateway)}`)}`}>{gateway.gateway}</a></td>
                  <td><State of={!gateway.alive ? "lost" : gateway.draining ? "draining" : gateway.frozen ? "frozen" : "ready"} /></td>
                  <td>{gateway.host}:{gateway.port}{gateway.tls ? " (TLS)" : ""}</td>
                  <td>{gateway.brokers.map((broker) => broker.name).join(", ")}</td>
                  <td>{age(gateway.since_ms)}</td>
                  <td>{mayAct() && gateway.alive && !gateway.draining && (
                    <button type="button" onClick={async () => {
                      if (await confirm({
                        title: `Drain ${gateway.gateway}?`, act: "Drain", destroys: true,
                        text: <p>All its instances are stopped, and it takes no new ones until you end the draining.</p>,
                      })) void order(`Drain ${gateway.gateway}`, "drain", {gateways: [gateway.gateway]});
                    }}>Drain</button>)}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      </Panel>
    </>
  );
}
