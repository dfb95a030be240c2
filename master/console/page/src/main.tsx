// The console: its frame, its pages, the log-in.
import {render} from "preact";
import {useEffect, useRef, useState} from "preact/hooks";
import {logIn, logOut, Refused} from "./api";
import {Fleet} from "./fleet";
import {History} from "./history";
import {Instance} from "./instance";
import {known, stateCame, want, type Wanted, whoAmI} from "./live";
import {Overview} from "./overview";
import {Notices, tell, useKnown} from "./parts";
import {Robots, usePages} from "./robots";
import {Tap} from "./tap";
import {Topologies} from "./topologies";
import {MessageWay} from "./way";
import "uplot/dist/uPlot.min.css";
import "./console.css";

// ---- light and dark

const themes = ["auto", "light", "dark"] as const;
type Theme = (typeof themes)[number];

function theme(): Theme {
  try {
    const kept = localStorage.getItem("theme") as Theme | null;
    return kept && themes.includes(kept) ? kept : "auto";
  } catch {
    return "auto";  // the browser keeps nothing
  }
}

function setTheme(next: Theme): void {
  try {
    localStorage.setItem("theme", next);
  } catch {
    // it counts until the page is closed
  }
  document.documentElement.dataset["theme"] = next;
  window.dispatchEvent(new Event("themechange"));
}

document.documentElement.dataset["theme"] = theme();
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => window.dispatchEvent(new Event("themechange")));

// ---- where we are: "#/fleet?where=..."

export interface Place {
  path: string[];
  query: URLSearchParams;
}

function place(): Place {
  const [path = "", query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  const words = path.split("/").filter(Boolean).map((word) => {
    try {
      return decodeURIComponent(word);
    } catch {
      return word;
    }
  });
  return {path: words, query: new URLSearchParams(query)};
}

const withRows = ["fleet", "tap", "way", "instance", "history"];

/** What the page at this place shows of the stream; null: nothing. */
function wantedAt({path, query}: Place): Wanted | null {
  const page = path[0] ?? "overview";
  return page === "robot" ? null : {
    rows: withRows.includes(page), where: page === "fleet" ? query.get("where") ?? "" : "",
    topology: page === "topology" ? path[1] ?? "" : "",
  };
}

function LogIn() {
  const [problem, setProblem] = useState("");
  const [busy, setBusy] = useState(false);
  const field = useRef<HTMLInputElement>(null);
  useEffect(() => field.current?.focus(), []);
  const submit = async (event: Event): Promise<void> => {
    event.preventDefault();
    setBusy(true);
    setProblem("");
    try {
      await logIn(field.current!.value.trim());
      await whoAmI();
    } catch (error) {
      setProblem(error instanceof Refused ? error.message : "the master does not answer");
      setBusy(false);
    }
  };
  return (
    <main class="login" id="content">
      <form onSubmit={submit}>
        <h1>IoTCloud</h1>
        <p>Console of the master <b>{known.me?.master}</b></p>
        <label>Your token
          <input ref={field} type="password" name="token" autocomplete="current-password" required spellcheck={false} />
        </label>
        <p class="quiet">An admin makes one with <code>iotcloud token add</code>. The browser gets a session for it, and does not
          keep it.</p>
        {problem && <p class="problem" role="alert">{problem}</p>}
        <button type="submit" class="primary" disabled={busy}>{busy ? "Logging in ..." : "Log in"}</button>
      </form>
    </main>
  );
}

async function leave(): Promise<void> {
  try {
    await logOut();
    await whoAmI();
  } catch (error) {
    tell(`You are still logged in: ${error instanceof Refused ? error.message : "the master does not answer"}`, "bad");
  }
}

const links: [string, string][] = [["overview", "Overview"], ["fleet", "Fleet"], ["topology", "Topologies"], ["tap", "Tap"],
                                   ["way", "Message way"], ["robot", "Robots"], ["history", "History"]];

function Console() {
  const {me, connected, state, silentSince} = useKnown();
  const [at, setAt] = useState(place());
  const [menu, setMenu] = useState(false);
  const [chosen, setChosen] = useState(theme());
  const main = useRef<HTMLElement>(null);
  useEffect(() => {
    const moved = (): void => {
      setAt(place());
      setMenu(false);
      main.current?.focus({preventScroll: true});
    };
    window.addEventListener("hashchange", moved);
    return () => window.removeEventListener("hashchange", moved);
  }, []);
  const page = at.path[0] ?? "overview";
  const robots = usePages(me?.role).length > 0;
  const wanted = wantedAt(at);
  const where = wanted?.where ?? "", topology = wanted?.topology ?? "";
  useEffect(() => {
    if (me && me.role !== "anyone" && wanted) want(wanted);
    document.title = `${links.find(([name]) => name === page)?.[1] ?? at.path[at.path.length - 1] ?? "Overview"} · IoTCloud`;
  }, [me?.role, where, topology, at.path.join("/")]);
  if (!me) return <p class="empty" role="status">Asking the master ...</p>;
  if (me.role === "anyone") return <LogIn />;
  const insteadOf = at.query.get("instead-of");
  return (
    <>
      <a class="skip" href="#content" onClick={(event) => { event.preventDefault(); main.current?.focus(); }}>To the content</a>
      <header class="top">
        <button type="button" class="menu" aria-expanded={menu} aria-controls="pages" onClick={() => setMenu(!menu)}>
          <span aria-hidden="true">☰</span><span class="hidden">Pages</span>
        </button>
        <a class="brand" href="#/overview"><img src="/icon.svg" alt="" width="22" height="22" />IoTCloud</a>
        <nav id="pages" class={menu ? "open" : ""} aria-label="Pages">
          {links.filter(([name]) => name !== "robot" || robots).map(([name, text]) => (
            <a key={name} href={`#/${name}`} aria-current={page === name || (name === "fleet" && page === "instance") ? "page" : undefined}>{text}</a>
          ))}
        </nav>
        <span class={connected ? "link up" : "link"} role="status">
          <span class="dot" aria-hidden="true" />
          {connected ? `${me.master}${state?.master.leading ? ", leads" : ""}` : "not connected"}
        </span>
        <label class="theme"><span class="hidden">Colours</span>
          <select value={chosen} onChange={(event) => {
            const next = event.currentTarget.value as Theme;
            setChosen(next);
            setTheme(next);
          }}>{themes.map((one) => <option key={one}>{one}</option>)}</select>
        </label>
        <span class="who">{me.name} <span class="role">{me.role}</span></span>
        {me.log_in && <button type="button" onClick={() => void leave()}>Log out</button>}
      </header>
      {!connected && (
        <div class="banner" role="alert">
          {`The master does not answer since ${new Date(silentSince).toLocaleTimeString()}; asking it again`}
          {me.others.length ? " and the other masters." : "."} What you see is what was last known.
        </div>
      )}
      {insteadOf && connected && (
        <div class="banner quiet-banner" role="status">
          {`Master ${insteadOf} did not answer: this is the console of ${me.master}. `}
          <a href={`#/${at.path.join("/")}`}>Good</a>
        </div>
      )}
      {state?.problem && connected && <div class="banner" role="alert">The master cannot see the fleet: {state.problem}</div>}
      <main id="content" ref={main} tabIndex={-1} class={connected ? "" : "stale"}>
        {page === "overview" ? <Overview />
          : page === "fleet" ? <Fleet where={where} />
          : page === "instance" ? <Instance key={at.path.join("/")} gateway={at.path[1] ?? ""} instance={at.path[2] ?? ""} />
          : page === "topology" ? <Topologies name={topology} component={topology ? at.query.get("component") ?? "" : ""} />
          : page === "tap" ? <Tap key={at.query.toString()} query={at.query} />
          : page === "way" ? <MessageWay query={at.query} />
          : page === "robot" ? <Robots name={at.path[1] ?? ""} query={at.query} />
          : page === "history" ? <History query={at.query} />
          : <p class="empty">There is no such page. <a href="#/overview">To the overview</a></p>}
      </main>
      <Notices />
    </>
  );
}

/** Waits 0.2 s at most for the first figures, so that they are painted with the frame and not after it. */
async function begin(): Promise<void> {
  const asked = whoAmI().then(() => {
    const wanted = wantedAt(place());
    if (!known.me || known.me.role === "anyone" || !wanted) return;
    want(wanted);
    return stateCame();
  });
  await Promise.race([asked, new Promise((resolve) => setTimeout(resolve, 200))]);
  render(<Console />, document.getElementById("page")!);
}

void begin();
