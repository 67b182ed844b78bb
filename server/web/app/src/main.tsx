// The page: a head with the session and its state, and one view below.
import { signal } from "@preact/signals";
import { render, type ComponentType } from "preact";
import { useEffect } from "preact/hooks";
import "uplot/dist/uPlot.min.css";
import "./page.css";
import { Entrance } from "./parts/Entrance";
import { Chip } from "./parts/Status";
import { Walk } from "./parts/Walk";
import { entrance, newestOnly } from "./state/api";
import { pause, step } from "./state/pictures";
import { begin, chosen, look, missing, service, session, sessions } from "./state/store";
import { unsaved } from "./state/unsaved";
import { filesOf } from "./sources/dropped";
import { Live } from "./views/Live";

interface View { id: string; title: string; load?: () => Promise<ComponentType> }

const VIEWS: View[] = [
  { id: "live", title: "Live" },
  { id: "plots", title: "Plots", load: async () => (await import("./views/Plots")).Plots },
  { id: "model", title: "Model", load: async () => (await import("./views/Model")).ModelView },
  { id: "explorer", title: "Explorer", load: async () => (await import("./views/Explorer")).Explorer },
  { id: "sources", title: "Sources", load: async () => (await import("./views/Sources")).Sources },
];

const shown = signal("");
const loaded = signal<Record<string, ComponentType>>({ live: Live });

const routing = newestOnly();

async function route() {
  // A view that was asked for later may be there sooner.
  const isNewest = routing();
  const id = VIEWS.find((view) => `#${view.id}` === location.hash)?.id ?? "live";
  const load = VIEWS.find((view) => view.id === id)?.load;
  if (!loaded.value[id] && load) {
    const made = await load();
    if (!isNewest()) return;
    loaded.value = { ...loaded.value, [id]: made };
  }
  if (shown.value && shown.value !== id) scrollTo(0, 0);
  shown.value = id;
}

/** Space pauses, arrows step through what was seen; not where one types. */
function keys(event: KeyboardEvent) {
  const at = event.target as HTMLElement;
  if (event.ctrlKey || event.metaKey || event.altKey || /^(INPUT|SELECT|TEXTAREA|BUTTON)$/.test(at.tagName) || at.shadowRoot) return;
  if (event.key === " ") pause();
  else if (event.key === "ArrowLeft") step(-1);
  else if (event.key === "ArrowRight") step(1);
  else if (/^[1-5]$/.test(event.key)) location.hash = VIEWS[Number(event.key) - 1]!.id;
  else return;
  event.preventDefault();
}

/** Images that are dropped are fitted, wherever on the page. */
async function dropped(event: DragEvent) {
  if (!event.dataTransfer?.files.length) return;
  event.preventDefault();
  const files = await filesOf(event.dataTransfer);
  const { take } = await import("./sources/ImageFit");
  take(files);
  location.hash = "sources";
}

const Nothing = () => null;

function Page() {
  useEffect(() => {
    begin();
    void route();
    addEventListener("hashchange", () => void route());
    addEventListener("keydown", keys);
    addEventListener("dragover", (event) => event.preventDefault());
    addEventListener("drop", (event) => void dropped(event));
  }, []);
  const View = loaded.value[shown.value] ?? Nothing;
  const one = session.value;
  return (
    <>
      <header>
        <h1><a href="#live">isophote</a></h1>
        {sessions.value.length > 1 ? (
          <select aria-label="session" value={chosen.value} onChange={(event) => look(event.currentTarget.value)}>
            {sessions.value.map((each) => <option key={each.name}>{each.name}</option>)}
          </select>
        ) : <span class="name">{chosen.value}</span>}
        {one && <span class="quiet active">{one.active_model}</span>}
        <Chip />
        <nav aria-label="views">
          {VIEWS.map((view) => <a key={view.id} href={`#${view.id}`} aria-current={shown.value === view.id ? "page" : undefined} title={view.id === "model" && unsaved.value ? `your edits of ${unsaved.value} are not stored` : undefined}>{view.title}{view.id === "model" && unsaved.value && " •"}</a>)}
          <a href="/docs/" class="book">Book</a>
        </nav>
      </header>
      {service.value.state === "away" && !entrance.value && <p class="banner" role="alert">{service.value.reason}. Trying again …</p>}
      {missing.value && <p class="banner" role="alert">There is no session {missing.value}{one ? `: this is ${one.name}` : ""}.</p>}
      <main>{entrance.value ? <Entrance /> : <View />}</main>
      {!entrance.value && <Walk />}
    </>
  );
}

render(<Page />, document.getElementById("page")!);
