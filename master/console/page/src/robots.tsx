// Pages of robots: plugins of the console, each in a frame of its own origin that has no session, no network, and what it asks
// for by messages (bridge.ts).
import {useEffect, useRef, useState} from "preact/hooks";
import {get} from "./api";
import {Bridge, type RobotsPage} from "./bridge";
import {want} from "./live";
import {Empty, Panel} from "./parts";

let pages: RobotsPage[] = [];

/** All pages; asks for them once more. */
export function usePages(asksAgain: unknown = null): RobotsPage[] {
  const [, draw] = useState(0);
  useEffect(() => {
    let ended = false;
    get("/api/pages").then((answer) => {
      pages = answer.pages;
      if (!ended) draw((n) => n + 1);
    }, () => undefined);  // the banner says that the master is silent
    return () => { ended = true; };
  }, [asksAgain]);
  return pages;
}

export const robotsPath = (name: string, query: Record<string, string> = {}): string => {
  const words = new URLSearchParams(query).toString();
  return `#/robot/${encodeURIComponent(name)}${words ? `?${words}` : ""}`;
};

/** Links to the pages for a driver. */
export function PagesOf({driver, query}: {driver: string; query: Record<string, string>}) {
  const fitting = usePages().filter((page) => page.driver === driver && !page.problem);
  if (!fitting.length) return null;
  return <p class="pages-of">{fitting.map((page) => <a key={page.name} href={robotsPath(page.name, query)}>Its page: {page.title}</a>)}</p>;
}

function Frame({page, query}: {page: RobotsPage; query: Record<string, string>}) {
  const frame = useRef<HTMLIFrameElement>(null);
  useEffect(() => {
    want({rows: true, where: `driver == ${JSON.stringify(page.driver)}`, topology: ""});
    const bridge = new Bridge(frame.current!, page, query);
    frame.current!.src = `/page/${encodeURIComponent(page.name)}`;
    return () => bridge.close();
  }, [page.name]);
  return <iframe ref={frame} class="robot" sandbox="allow-scripts" referrerpolicy="no-referrer" title={`Page of the robot: ${page.title}`} />;
}

export function Robots({name, query}: {name: string; query: URLSearchParams}) {
  const all = usePages(name);
  const page = all.find((one) => one.name === name);
  const framed = !!page && !page.problem;
  useEffect(() => {
    if (!framed) want({rows: false, where: "", topology: ""});  // a frame wants its driver's instances
  }, [framed]);
  if (framed) {
    return (
      <>
        <h1>{page.title} <span class="quiet">for the driver {page.driver}{page.signed_by ? `, signed by ${page.signed_by}` : ""}</span></h1>
        <Frame key={page.name} page={page} query={Object.fromEntries(query)} />
      </>
    );
  }
  return (
    <>
      <h1>Robots</h1>
      {page?.problem && <p class="problem" role="alert">The page {page.name} is not shown: {page.problem}</p>}
      {name && !page && all.length > 0 && <p class="problem" role="alert">There is no page {name}.</p>}
      <Panel title="Pages">
        {!all.length ? <Empty>This console has no pages of robots; console: {"{pages: {folder: ...}}"} in the master's file names their folder.</Empty> : (
          <div class="scroll"><table>
            <thead><tr><th>Page</th><th>For the driver</th><th>Signed by</th><th>Not shown because</th></tr></thead>
            <tbody>{all.map((one) => (
              <tr key={one.name}>
                <td>{one.problem ? one.name : <a href={robotsPath(one.name)}>{one.title}</a>}</td>
                <td>{one.driver || "-"}</td><td>{one.signed_by || "-"}</td><td class={one.problem ? "bad-text" : ""}>{one.problem || "-"}</td>
              </tr>
            ))}</tbody>
          </table></div>
        )}
      </Panel>
    </>
  );
}
