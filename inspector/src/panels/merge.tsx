// One merge: how far it is, what was found, the maps on each other, and what a person decides.
import { createContext } from "preact";
import { useContext, useState } from "preact/hooks";
import { hash, START, type Go, type Link } from "../link";
import { pose } from "../drawing/geometry";
import { baseOf, broughtOf, partsOf } from "../drawing/overlay";
import { all, at, change, get, Refusal, short, type Job, type Merge, type Schemas, type Session, type WayMap } from "../rest";
import {
    fixed, keepsPictures, moment, NoPicture, Outcome, Picture, plural, Question, Refused, share, Shown, useAsked, useAttempt, useMayAll, usePolled,
} from "../parts";
import { Large, pairPath } from "./large";
import { State } from "./merges";
import { Overlay } from "./overlay";

/** How often a merge is asked for while a job works on it, and how often while none does: others decide, too. */
const BUSY_EVERY_MS = 700;
const EVERY_MS = 10_000;

interface Known {
    merge: Merge;
    job: Job | null;
}

async function known(number: number, signal: AbortSignal): Promise<Known> {
    const merge = await get<Merge>(at(`merges/${number}`), signal);
    const job = await get<Job>(at(merge.job), signal).catch((error: Error) => {
        // Jobs are forgotten after a month.
        if (error instanceof Refusal && error.code === "not_found") return null;
        throw error;
    });
    return { merge, job };
}

interface MergePageProps {
    number: number;
    link: Link;
    go: Go;
}

export function MergePage({ number, link, go }: MergePageProps) {
    const { value, error, again } = usePolled((signal) => known(number, signal), (value) => value?.job?.state === "running" ? BUSY_EVERY_MS : EVERY_MS);
    return (
        <main class="merge" id="content">
            {error && <Refused error={error} />}
            {value ? <Loaded {...value} link={link} go={go} onDecided={again} /> : !error && <p class="quiet" role="status">Loading the merge…</p>}
        </main>
    );
}

interface LoadedProps extends Known {
    link: Link;
    go: Go;
    onDecided: () => void;
}

/** Maps that are there and keep something to be seen; nothing before that is known. A merge outlives its maps. */
const Pictured = createContext<Set<string> | null>(null);

function Loaded({ merge, job, link, go, onDecided }: LoadedProps) {
    const { state, sources, target } = merge;
    const maps = useAsked((signal) => all<"maps", WayMap>("/v1/maps", "maps", signal), [merge.name, state]);
    const pictured = maps.state === "there" ? new Set(maps.value.filter(keepsPictures).map(({ name }) => name)) : null;
    const drawn = state !== "searching" && sources.some((source) => source.overlap || source.no_overlap_reason);
    const laid = state !== "searching" && sources.some((source) => source.overlap?.transformation);
    return <>
        <div class="title">
            <h1>Merge {short(merge.name)}</h1><State state={state} />
            <p class="quiet">{partsOf(merge).map(short).join(", ")} into {short(target)} · {moment(merge.create_time_ns)}</p>
            <p class="actions"><Decisions merge={merge} job={job} onDecided={onDecided} /></p>
        </div>
        <Progress merge={merge} job={job} onCancelled={onDecided} />
        <div class="columns">
            <div class="broad">
                {laid && <Overlay merge={merge} link={link} go={go} />}
                {drawn && <Before merge={merge} />}
            </div>
            <div class="narrow">
                <Base merge={merge} />
                <Pictured.Provider value={pictured}>{sources.map((source) => <Source key={source.map} source={source} searching={state === "searching"} link={link} go={go} />)}</Pictured.Provider>
            </div>
        </div>
    </>;
}

/** What the job that works on it does, and the reason if it could not. */
function Progress({ merge, job, onCancelled }: Known & { merge: Merge; onCancelled: () => void }) {
    const may = useMayAll();
    const { told, busy, attempt } = useAttempt();
    const cancel = async () => {
        await attempt("Cancelling", async () => {
            await change("POST", `${at(merge.job)}/cancel`);
            return "it is asked to end";
        });
        onCancelled();
    };
    const why = merge.error ?? job?.error ?? null;
    return <>
        {why && <p class="refused spaced" role="alert">{why.message}</p>}
        {job?.state === "running" && (
            <p class="actions spaced">
                <progress aria-label="progress" value={job.fraction} max={1} /> <span class="quiet">{job.stage || "waiting"}</span>
                {may && <button type="button" disabled={busy} onClick={() => void cancel()}>Cancel</button>}
            </p>
        )}
        {told.state !== "idle" && <Outcome told={told} />}
    </>;
}

function Decisions({ merge, job, onDecided }: Known & { merge: Merge; onDecided: () => void }) {
    const may = useMayAll();
    const [asking, setAsking] = useState<Schemas["Decided"] | null>(null);
    const target = short(merge.target);
    const close = () => setAsking(null);
    const decide = (decision: Schemas["Decided"]) => {
        const asked: Schemas["Decision"] = { decision };
        return change<Merge>("PUT", `${at(merge.name)}/decision`, asked);
    };
    const common = { onClose: close, onDone: () => {
        close();
        onDecided();
    } };
    const working = job?.state === "running";
    return <>
        {merge.state === "committed" && <a href={hash({ ...START, page: "map", map: target })}>Open the map {target}</a>}
        {may && merge.state === "proposed" && <>
            <button type="button" class="main" disabled={working} onClick={() => setAsking("commit")}>Commit</button>
            <button type="button" disabled={working} onClick={() => setAsking("discard")}>Discard</button>
        </>}
        {may && merge.state === "committed" && <button type="button" disabled={working} onClick={() => setAsking("undo")}>Undo</button>}
        {asking === "commit" && (
            <Question
                title={`Merge into ${target}?`} verb="Commit the merge" doing="Asking for it" act={() => decide("commit")} {...common}
                loss={`The map ${target} gets what the others bring. They stay as they are, and the merge can be undone until ${target} is compacted.`}
            />
        )}
        {asking === "discard" && (
            <Question
                title="Discard what was found?" verb="Discard it" doing="Discarding" act={() => decide("discard")} {...common}
                loss="The maps stay as they are. To merge them, the overlap has to be looked for anew."
            />
        )}
        {asking === "undo" && (
            <Question
                title={`Undo merge ${short(merge.name)}?`} name={target} verb="Undo the merge" doing="Asking for it" act={() => decide("undo")} {...common}
                loss={`What the merge has brought is taken out of the map ${target}; a map that it has made goes as a whole. Places may then have other numbers.`}
            />
        )}
    </>;
}

function Before({ merge }: { merge: Merge }) {
    const [large, setLarge] = useState(false);
    const path = `${at(merge.name)}/picture`;
    const alt = `The maps before and after merge ${short(merge.name)}: ways, links within a session and links between sessions`;
    return (
        <section class="panel" aria-label="Before and after">
            <header><h2>Before and after</h2><span class="quiet small">as the search left them; of each map its largest part</span></header>
            <button type="button" class="enlarge" aria-label={`Enlarge: ${alt}`} onClick={() => setLarge(true)}><Picture path={path} alt="" class="sheet" /></button>
            {large && <Large path={path} alt={alt} as="drawn" onClose={() => setLarge(false)} />}
        </section>
    );
}

/** The map that the others are merged into: of what it holds already, they bring more. */
function Base({ merge }: { merge: Merge }) {
    const map = baseOf(merge);
    const asked = useAsked(async (signal) => {
        try {
            return await Promise.all([get<WayMap>(at(map), signal), all<"sessions", Session>(`${at(map)}/sessions`, "sessions", signal)]);
        } catch (error) {
            // A merge outlives its maps.
            if (error instanceof Refusal && error.code === "not_found") return null;
            throw error;
        }
    }, [map, merge.state]);
    return (
        <section class="panel" aria-label={`The base ${short(map)}`}>
            <header><h2>{short(map)}</h2><span class="quiet">the base: the others are laid on it</span></header>
            <Shown asked={asked} what="the base">
                {(found) => found === null ? <p class="quiet">There is no such map any more.</p> : <Sessions known={found[0]} sessions={found[1]} brought={broughtOf(merge)} />}
            </Shown>
        </section>
    );
}

function Sessions({ known, sessions, brought }: { known: WayMap; sessions: Session[]; brought: Set<string> }) {
    const own = sessions.filter(({ name }) => !brought.has(name));
    return <>
        <p>{plural(known.places, "place")} · {plural(known.links, "link")} · {plural(known.loop_closures, "loop closure")}</p>
        <h3>{plural(own.length, "session")} of its own</h3>
        {own.length === 0 ? <p class="quiet">None: no robot has driven in it yet.</p> : (
            <ul class="sessions">{own.map(({ name, frames, first_stamp_ns }) => (
                <li key={name}><a href={hash({ ...START, page: "map", map: short(known.name), session: short(name) })}>{short(name)}</a> <span class="quiet small">{plural(frames, "frame")}{typeof first_stamp_ns === "number" && `, from ${moment(first_stamp_ns)}`}</span></li>
            ))}</ul>
        )}
    </>;
}

type MapOverlap = Schemas["MapOverlap"];

interface SourceProps {
    source: Schemas["MergeSource"];
    searching: boolean;
    link: Link;
    go: Go;
}

function Source({ source, searching, link, go }: SourceProps) {
    const { map, places, overlap, no_overlap_reason, sessions } = source;
    return (
        <section class="panel" aria-label={`Evidence for ${short(map)}`}>
            <header><h2>{short(map)}</h2>{!searching && <span class="quiet">{plural(places, "place")}</span>}</header>
            {overlap ? <Evidence overlap={overlap} link={link} go={go} /> : no_overlap_reason ? <p>No overlap: {no_overlap_reason}</p> : <p class="quiet">{searching ? "It is being looked for." : "It was not looked for to the end."}</p>}
            {sessions.length > 0 && <p class="quiet small">Its {sessions.length === 1 ? "session" : "sessions"} in the target: {sessions.join(", ")}</p>}
        </section>
    );
}

function Evidence({ overlap, link, go }: { overlap: MapOverlap; link: Link; go: Go }) {
    const where = pose(overlap.transformation);
    return <>
        <dl class="facts">
            <div><dt>matches that agree</dt><dd>{overlap.agreeing_matches}</dd></div>
            <div><dt>all other matches</dt><dd>{overlap.rejected_matches}</dd></div>
            <div><dt>next best way</dt><dd>{plural(overlap.rival_matches, "match", "matches")}</dd></div>
            <div><dt>fused places</dt><dd>{overlap.fused_places}</dd></div>
            <div><dt>where both were</dt><dd>{overlap.confirmed_places} of {plural(overlap.overlapping_places, "place")} match</dd></div>
            <div><dt>cost of all links</dt><dd>{overlap.cost_before.toFixed(1)} apart, {overlap.cost_after.toFixed(1)} together</dd></div>
            <div><dt>lies at</dt><dd>{where ? `${fixed(where.x, 2)}, ${fixed(where.y, 2)} m, turned by ${fixed((where.heading * 180) / Math.PI, 1)}°` : "not known: one of the maps has no metres"}</dd></div>
        </dl>
        <Matches matches={overlap.strongest_matches} link={link} go={go} />
    </>;
}

const MOST_MATCHES = 12;

/** Matches, of which the link may show one as a pair: its source frame beside the target's. */
function Matches({ matches, link, go }: { matches: MapOverlap["strongest_matches"]; link: Link; go: Go }) {
    const pictured = useContext(Pictured);
    if (matches.length === 0) return null;
    const seen = (frame: string) => pictured?.has(mapOf(frame)) ?? false;
    const opened = matches.find(({ source_frame, target_frame }) => link.pair?.[0] === source_frame && link.pair[1] === target_frame);
    return <>
        <h3>The strongest matches</h3>
        {opened && (
            <Large
                path={pairPath(opened.source_frame, opened.target_frame)} as="fitted" onClose={() => go({ pair: null })}
                alt={`Place ${opened.source_place_number} beside place ${opened.target_place_number} of the target: what the two frames share, joined by lines`}
            />
        )}
        <div class="wide tall" tabIndex={0} role="group" aria-label="Table of matches"><table>
            <thead><tr><th scope="col">place</th><th scope="col">place of the target</th><th scope="col">evidence</th><th scope="col"><span class="unseen">what they share</span></th></tr></thead>
            <tbody>
                {matches.slice(0, MOST_MATCHES).map((match) => (
                    <tr key={`${match.source_place_number} ${match.target_place_number}`}>
                        <td><Seen frame={match.source_frame} note={match.source_note} place={match.source_place_number} /></td>
                        <td><Seen frame={match.target_frame} note={match.target_note} place={match.target_place_number} /></td>
                        <td>{match.evidence_inliers === null ? "by words" : plural(Math.round(match.evidence_inliers), "inlier")}<br /><span class="quiet small">words {share(match.posterior)}</span></td>
                        <td class="do">{seen(match.source_frame) && seen(match.target_frame) && <button type="button" aria-label={`Compare place ${match.source_place_number} with place ${match.target_place_number} of the target`} onClick={() => go({ pair: [match.source_frame, match.target_frame] })}>Compare</button>}</td>
                    </tr>
                ))}
            </tbody>
        </table></div>
    </>;
}

/** A frame of a match, as maps/{map}/sessions/{session}/frames/{sequence}. */
function Seen({ frame, note, place }: { frame: string; note: string; place: number }) {
    const pictured = useContext(Pictured);
    const [, map = "", , session = "", , sequence = ""] = frame.split("/");
    return (
        <a class="seen" href={hash({ ...START, page: "map", map, session, frame: sequence })} title={`${map}, ${session}, ${note || `frame ${sequence}`}`}>
            {pictured?.has(mapOf(frame)) && <Picture path={`${at(frame)}/image?size=thumbnail`} alt="" />}
            {pictured?.has(mapOf(frame)) === false && <NoPicture why="The map is gone, or keeps words alone" />}
            <span>place {place}</span>
        </a>
    );
}

/** The map of a frame, as maps/{map}. */
function mapOf(frame: string): string {
    return frame.split("/").slice(0, 2).join("/");
}
