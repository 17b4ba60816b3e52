// Maps that become one: all merges there were, and what begins another.
import { useState } from "preact/hooks";
import { partsOf } from "../drawing/overlay";
import { hash, START, type Go, type Link } from "../link";
import { all, change, short, type Merge, type Schemas, type WayMap } from "../rest";
import { moment, Outcome, plural, Refused, useAttempt, useMayAll, usePolled } from "../parts";
import { ByHand } from "./overlay";

/** Merges are asked for again, sooner while one of them is looked for. */
const SEARCH_EVERY_MS = 2000;
const EVERY_MS = 10_000;
const MOST_MERGES = 200;

interface MergesProps {
    link: Link;
    go: Go;
}

export function Merges({ link, go }: MergesProps) {
    const may = useMayAll();
    return (
        <main class="operations" id="content">
            <h1>Merges</h1>
            {may && <Beginning link={link} go={go} />}
            <List />
        </main>
    );
}

export const STATES: Record<Merge["state"], string> = {
    searching: "searching", proposed: "proposed", no_overlap: "no overlap", committed: "committed",
    discarded: "discarded", undone: "undone", failed: "failed",
};

export function State({ state }: { state: Merge["state"] }) {
    return <span class={`reason ${state}`} data-testid="state">{STATES[state]}</span>;
}

function List() {
    const { value: merges, error } = usePolled(
        (signal) => all<"merges", Merge>("/v1/merges", "merges", signal, MOST_MERGES),
        (merges) => !merges || merges.some(({ state }) => state === "searching") ? SEARCH_EVERY_MS : EVERY_MS,
    );
    return (
        <section class="panel" aria-label="All merges">
            <header><h2>All merges</h2></header>
            {error && <Refused error={error} />}
            {merges === null ? !error && <p class="quiet" role="status">Loading merges…</p>
                : merges.length === 0 ? <p class="quiet">No maps were merged yet. Maps of the same places, of any number of days and robots, can become one.</p>
                : <Table merges={merges} />}
        </section>
    );
}

function Table({ merges }: { merges: Merge[] }) {
    return (
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of merges"><table>
            <thead><tr><th scope="col">merge</th><th scope="col">state</th><th scope="col">maps</th><th scope="col">into</th><th scope="col">began</th><th scope="col">why not</th></tr></thead>
            <tbody>
                {merges.map((merge) => (
                    <tr key={merge.name}>
                        <th scope="row" class="short"><a href={hash({ ...START, page: "merges", merge: Number(short(merge.name)) })}>merge {short(merge.name)}</a></th>
                        <td><State state={merge.state} /></td><td>{partsOf(merge).map(short).join(", ")}</td><td>{short(merge.target)}</td>
                        <td class="short">{moment(merge.create_time_ns)}</td><td>{merge.error?.message ?? merge.sources.find((source) => source.no_overlap_reason)?.no_overlap_reason ?? ""}</td>
                    </tr>
                ))}
            </tbody>
        </table></div>
    );
}

function Beginning({ link, go }: MergesProps) {
    const { value: maps, error } = usePolled((signal) => all<"maps", WayMap>("/v1/maps", "maps", signal), () => EVERY_MS);
    return (
        <section class="panel" aria-label="Merge maps">
            <header><h2>Merge maps</h2><span class="quiet small">Nothing changes before an overlap is found, shown and committed. The maps themselves stay as they are.</span></header>
            {error && <Refused error={error} />}
            {maps === null ? !error && <p class="quiet" role="status">Loading maps…</p>
                : maps.length < 2 ? <p class="quiet">It takes two maps, and there {maps.length === 1 ? "is one" : "is none"}.</p>
                : <Request maps={maps} link={link} go={go} />}
        </section>
    );
}

/** What is chosen is in the link, but for committing unseen: nobody else decides that. */
function Request({ maps, link, go }: MergesProps & { maps: WayMap[] }) {
    const [support, setSupport] = useState("");
    const [unseen, setUnseen] = useState(false);
    const { told, busy, attempt } = useAttempt();
    const { sources, target } = link;
    const choose = (map: string, chosen: boolean) =>
        // Who is moved by hand is another one then.
        go({ sources: [...sources.filter((known) => known !== map), ...(chosen ? [map] : [])], laid: link.laid && [] });
    const begin = () => attempt("Asking for it", async () => {
        const request: Schemas["MergeMaps"] = {
            sources: sources.map((map) => `maps/${map}`), target: `maps/${target}`, auto_commit: unseen,
            min_support: support ? Number(support) : null,
        };
        const { name } = await change<Merge>("POST", "/v1/merges", request);
        go({ ...START, page: "merges", merge: Number(short(name)) });
        return "";
    });
    // A target that is there is what the others would be laid on.
    const there = maps.some(({ name }) => short(name) === target) && !sources.includes(target);
    const shown = there ? [target, ...sources] : sources;
    return <>
        <form class="merging" onSubmit={(event) => {
            event.preventDefault();
            void begin();
        }}>
            <fieldset>
                <legend>Maps to merge</legend>
                {maps.map(({ name, places }) => (
                    <label key={name} class="choice">
                        <input type="checkbox" checked={sources.includes(short(name))} onChange={(event) => choose(short(name), event.currentTarget.checked)} />
                        {" "}<span>{short(name)}</span> {plural(places, "place")}
                    </label>
                ))}
            </fieldset>
            <div class="making">
                <label>Into <input value={target} required list="known-maps" autoComplete="off" spellcheck={false} placeholder="a new name, or a map" onInput={(event) => go({ target: event.currentTarget.value })} /></label>
                <datalist id="known-maps">{maps.map(({ name }) => <option key={name} value={short(name)} />)}</datalist>
                <label>Matches that must agree <input class="few" type="number" min={3} value={support} placeholder="5" onInput={(event) => setSupport(event.currentTarget.value)} /></label>
                <label class="choice"><input type="checkbox" checked={unseen} onChange={(event) => setUnseen(event.currentTarget.checked)} /> <span>commit unseen</span></label>
                {shown.length > 1 && <button type="button" aria-pressed={link.laid !== null} onClick={() => go({ laid: link.laid ? null : [], view: null })}>On each other</button>}
                <button type="submit" class="main" disabled={busy || sources.length === 0 || !target}>{unseen ? "Merge them" : "Look for the overlap"}</button>
            </div>
            <Outcome told={told} />
        </form>
        {shown.length > 1 && link.laid && <ByHand maps={shown} link={link} go={go} />}
    </>;
}
