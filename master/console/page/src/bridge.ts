// What a robot's page, in a frame of its own origin, may ask the console for: the messages of README.md. All of it a viewer may
// see, and only of instances of the driver that the page is for; nothing here gives an order.
import {call, type Row, type TopologyPages} from "./api";
import {height, millimetres, NoDepth, width} from "./depth";
import {known, subscribe, want} from "./live";
import {decode} from "./tap";

export interface RobotsPage {
  name: string;
  title: string;
  driver: string;
  signed_by: string;
  problem: string;
}

const version = 1, mostTaps = 8, mostPerSecond = 10, mostMessages = 64, mostBytes = 262_144;  // as much as a driver host keeps of an answer
const lookName = `page-${Math.random().toString(36).slice(2)}`;

/** An ask that the page gets a problem for. */
class Wrong extends Error {}

interface Tap {
  gateway: string;
  instance: string;
  channel: string;
  look: string;
}

function text(of: Record<string, unknown>, key: string): string {
  const value = of[key];
  if (typeof value !== "string" || value.length > 1000) throw new Wrong(`"${key}" is a text`);
  return value;
}
function number(of: Record<string, unknown>, key: string, usual: number, most: number): number {
  const value = of[key] ?? usual;
  if (typeof value !== "number" || !(value >= 0)) throw new Wrong(`"${key}" is a number from 0`);
  return Math.min(value, most);
}

const theme = (): string => {
  const chosen = document.documentElement.dataset["theme"];
  return chosen === "light" || chosen === "dark" ? chosen : matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
};

/** Serves one page, from its frame's load on until close(). */
export class Bridge {
  private port: MessagePort | null = null;
  private readonly taps = new Map<unknown, Tap>();
  private instancesId: unknown = null;
  private metricsId: unknown = null;
  private toldRows = -1;
  private toldPages: TopologyPages | null = null;
  private ended = false;
  private readonly unsubscribe: () => void;

  /** \param query of the console's address, for the page to begin with */
  constructor(private readonly frame: HTMLIFrameElement, private readonly page: RobotsPage, private readonly query: Record<string, string>) {
    this.unsubscribe = subscribe(this.tell);
    window.addEventListener("themechange", this.tellTheme);
    frame.addEventListener("load", this.begin);
  }

  close(): void {
    this.ended = true;
    this.unsubscribe();
    window.removeEventListener("themechange", this.tellTheme);
    this.frame.removeEventListener("load", this.begin);
    this.forget();
  }

  private forget(): void {
    this.port?.close();
    this.port = null;
    for (const tap of this.taps.values()) void call("look", {...tap, most: 0, last: true}).catch(() => undefined);
    this.taps.clear();
    this.instancesId = this.metricsId = null;
  }

  /** A page has no origin that a message could be addressed to, so its window gets a port, and only this one message by name. */
  private readonly begin = (): void => {
    this.forget();
    const channel = new MessageChannel();
    this.port = channel.port1;
    this.port.onmessage = (event) => this.answer(event.data);
    this.frame.contentWindow?.postMessage({iotcloud: version, title: this.page.title, driver: this.page.driver, theme: theme(), query: this.query}, "*",
                                          [channel.port2]);
  };

  private send(message: object, transfer: Transferable[] = []): void {
    this.port?.postMessage(message, transfer);
  }

  private answer(asked: unknown): void {
    if (typeof asked !== "object" || asked === null) return;
    const given = asked as Record<string, unknown>;
    const id = given["id"];
    try {
      if (typeof id !== "string" && typeof id !== "number") throw new Wrong('"id" is a text or a number, which the answers have');
      switch (given["ask"]) {
        case "instances":
          this.instancesId = id;
          this.toldRows = -1;
          return this.tell();
        case "metrics":
          this.metricsId = id;
          this.toldPages = null;
          want({rows: true, where: this.where(), topology: text(given, "topology")});
          return;
        case "tap":
          return this.tap(id, given);
        case "end":
          return this.end(id);
        default:
          throw new Wrong("there is no such ask; there are: instances, tap, metrics, end");
      }
    } catch (error) {
      if (!(error instanceof Wrong)) throw error;
      this.send({id, problem: error.message});
    }
  }

  where(): string {
    return `driver == ${JSON.stringify(this.page.driver)}`;
  }

  private readonly tellTheme = (): void => this.send({event: "theme", theme: theme()});

  private readonly tell = (): void => {
    if (this.instancesId !== null && known.rowsComplete && known.rowsVersion !== this.toldRows) {
      this.toldRows = known.rowsVersion;
      const instances = [...known.rows.values()].filter((row) => row.driver === this.page.driver).map((row: Row) => ({
        gateway: row.gateway, instance: row.instance, name: row.name, state: row.state, reason: row.reason, since_ms: row.since_ms,
        metadata: row.metadata,
      }));
      this.send({id: this.instancesId, instances, topologies: known.state?.topologies.map((one) => one.name) ?? []});
    }
    if (this.metricsId !== null && known.topology && known.topology !== this.toldPages) {
      this.toldPages = known.topology;
      this.send({id: this.metricsId, metrics: {topology: known.topology.topology, at_ms: known.topology.at_ms,
                                               tasks: known.topology.pages.flatMap((page) => page.tasks)}});
    }
  };

  private end(id: unknown): void {
    const tap = this.taps.get(id);
    this.taps.delete(id);
    if (tap) void call("look", {...tap, most: 0, last: true}).catch(() => undefined);
    if (this.instancesId === id) this.instancesId = null;
    if (this.metricsId === id) this.metricsId = null;
  }

  private tap(id: string | number, given: Record<string, unknown>): void {
    const tap = {gateway: text(given, "gateway"), instance: text(given, "instance"), channel: text(given, "channel"), look: `${lookName}-${id}`};
    const most = Math.max(1, Math.round(number(given, "most", 16, mostMessages)));
    const bytes = Math.round(number(given, "bytes", mostBytes, mostBytes));
    const perSecond = Math.max(0.1, number(given, "per_second", 2, mostPerSecond));
    const depth = given["depth"] === true;
    if (known.rows.get(`${tap.gateway}/${tap.instance}`)?.driver !== this.page.driver)
      throw new Wrong(`this page is for instances of ${this.page.driver}, and this is none that is deployed`);
    if (!this.taps.has(id) && this.taps.size >= mostTaps) throw new Wrong(`a page has ${mostTaps} taps at most; end one`);
    this.end(id);
    this.taps.set(id, tap);
    const next = async (): Promise<void> => {
      if (this.ended || this.taps.get(id) !== tap) return;
      if (!document.hidden) await this.look(id, tap, most, bytes, depth);
      window.setTimeout(() => void next(), 1000 / perSecond);
    };
    void next();
  }

  private async look(id: string | number, tap: Tap, most: number, bytes: number, depth: boolean): Promise<void> {
    try {
      const look = await call("look", {...tap, most, bytes});
      if (this.taps.get(id) !== tap) return;
      if (look.problem) return this.send({id, problem: look.problem});
      const transfer: Transferable[] = [];
      const messages = look.messages.map((message: any) => {
        const payload = decode(message.payload);
        const own = {number: message.number, seen_ms: message.seen_ms, time_ms: message.time_ms, size: message.size, properties: message.properties ?? {}};
        if (!depth || payload.length < message.size) {
          transfer.push(payload.buffer);
          return {...own, payload};
        }
        try {
          const mm = millimetres(payload);
          transfer.push(mm.buffer);
          return {...own, depth: {width, height, mm}};
        } catch (error) {
          if (!(error instanceof NoDepth)) throw error;
          return {...own, problem: error.message};
        }
      });
      this.send({id, tap: {elapsed_us: look.elapsed_us, count: look.count, bytes: look.bytes, missed: look.missed, messages}}, transfer);
    } catch (error) {
      this.send({id, problem: error instanceof Error ? error.message : "the master does not answer"});
    }
  }
}
