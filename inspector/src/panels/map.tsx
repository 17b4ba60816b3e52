// One map: its drawing, its time, the frame under the cursor and the place that it shows. One cursor drives all.
import { useEffect, useLayoutEffect, useMemo, useRef, useState } from "preact/hooks";
import { load, MOST_DRIVES, type MapData } from "../drawing/data";
import { asDriven, kindOf, sceneOf, type Scene } from "../drawing/scene";
import { ring } from "../drawing/layout";
import type { Colour, Go, Link, Shape } from "../link";
import type { Size, View } from "../drawing/paint";
import { at, get, short, type Place as PlaceRecord } from "../rest";
import { count, plural, Shown, useAsked } from "../parts";
import { MapCanvas } from "./canvas";
import { Evidence } from "./evidence";
import { Matrix } from "./matrix";
import { Pair } from "./pair";
import { Place } from "./place";
import { useCloser } from "./closer";
import { useFresh, useLive, type Live } from "./live";
import { Robots } from "./robots";
import { useSteps, type Step } from "./steps";
import { Time } from "./time";

interface MapPageProps {
    link: Link;
    go: Go;
}

export function MapPage({ link, go }: MapPageProps) {
    const [asks, setAsks] = useState(0);
    const asked = useAsked((signal) => load(link.map, signal), [link.map, asks]);
    return (
        <main class="map" id="content">
            <Shown asked={asked} what={`the map ${link.map}`}>
                {(data) => <Loaded key={`${data.map.name} ${asks}`} given={data} link={link} go={go} onAgain={() => setAsks(asks + 1)} />}
            </Shown>
        </main>
    );
}

function Loaded({ given, link, go, onAgain }: MapPageProps & { given: MapData; onAgain: () => void }) {
    const { data, refresh, renew, setLabels } = useFresh(given);
    const [lists, setLists] = useState(0);
    const { map, sessions } = data;
    const session = sessions.find(({ name }) => short(name) === link.session) ?? sessions[0] ?? null;
    const { steps, whole, more, error, hear } = useSteps(session, link.frame, lists);
    const cursor = cursorOf(steps, link.frame);
    const coming = (!whole || more[1]) && link.frame !== null && link.frame > (steps.at(-1)?.sequence ?? -1);
    const step = coming ? null : (steps[cursor] ?? null);
    const place = link.place ?? step?.place ?? null;
    const heard = useLive(map.name, {
        renew: () => void renew().then((another) => another && setLists((lists) => lists + 1)),
        frames: (frames) => {
            hear(frames);
            refresh();
        },
    });
    const newest = link.follow ? heard.streaming.at(-1) : undefined;
    const known = newest && sessions.some(({ name }) => name === newest.session);
    useEffect(() => {
        if (newest && known) go({ session: short(newest.session), frame: Number(short(newest.frame.name)), place: null });
    }, [newest?.frame.name, known]);
    const { closer, onSeen } = useCloser(data);
    const scene = useMemo(() => sceneOf(closer, link.shape), [closer, link.shape]);

    // Keys may come faster than the page is drawn: each goes on from the one before.
    const latest = useRef(cursor);
    useLayoutEffect(() => {
        latest.current = cursor;
    }, [cursor]);
    const toFrame = (frame: number) =>
        go({ frame, place: null, beside: null, follow: false, session: session ? short(session.name) : null });
    const onCursor = (index: number | "first" | "last") => {
        const end = index === "first" ? session?.first_sequence : index === "last" ? session?.last_sequence : null;
        if (typeof end === "number" && (more[0] || more[1])) return toFrame(end);
        const wanted = index === "first" ? 0 : index === "last" ? steps.length - 1 : index;
        const nearest = Math.min(Math.max(wanted, 0), steps.length - 1);
        const to = steps[nearest];
        if (to) latest.current = nearest;
        if (to) toFrame(to.sequence);
    };
    const onFrame = (session: string, frame: number) => go({ session: short(session), frame, place: null, beside: null, follow: false });
    const framesOf = async (number: number) => {
        const known = closer.placeOf(number) ?? (data.every > 1 ? await get<PlaceRecord>(at(`${map.name}/places/${number}`)).catch(() => undefined) : undefined);
        return known?.frames ?? [];
    };
    const onPlace = (number: number) => void framesOf(number).then((frames) => {
        const first = frames.find((frame) => frame.session === session?.name) ?? frames[0];
        go({ place: number, beside: null, follow: false, ...(first && { session: short(first.session), frame: first.sequence }) });
    });
    const onPair = (number: number, beside: number) => void framesOf(number).then(([first]) => {
        go({ place: number, beside, follow: false, ...(first && { session: short(first.session), frame: first.sequence }) });
    });
    useKeys((by) => onCursor(latest.current + by), onCursor);
    return <>
        <div class="title">
            <h1>{short(map.name)}</h1>
            <p class="quiet">
                {plural(map.places, "place")} · {plural(map.links, "link")} · {plural(map.loop_closures, "loop closure")}{map.withdrawn_loop_closures > 0 && `, ${map.withdrawn_loop_closures} withdrawn`} · {plural(map.frames, "frame")}
            </p>
            <GoTo data={data} onPlace={onPlace} />
            <label class="choice" title="The cursor goes with the newest frame"><input type="checkbox" checked={link.follow} onChange={(event) => go({ follow: event.currentTarget.checked })} /> <span>follow</span></label>
            <button type="button" onClick={onAgain}>Load anew</button>
        </div>
        <div class="columns">
            <div class="broad">
                <Drawing data={data} scene={scene} link={link} go={go} place={place} heard={heard} onPlace={onPlace} onSeen={(view, size) => onSeen(scene, view, size)} />
                {session && (
                    <Time
                        sessions={sessions} session={session} steps={steps} whole={whole} more={more} error={error} cursor={cursor}
                        threshold={map.settings?.closure_threshold ?? null} onCursor={onCursor}
                        onSession={(name) => go({ session: short(name), frame: null, place: null, follow: false })}
                        onDeleted={() => {
                            go({ session: null, frame: null, place: null });
                            onAgain();
                        }}
                    />
                )}
                <Matrix data={closer} link={link} go={go} onPair={onPair} onPlace={onPlace} />
            </div>
            <div class="narrow">
                {session && step && <Pair session={session.name} step={step} beside={link.beside} large={link.large} follow={link.follow} onLarge={(large) => go({ large })} onPlace={onPlace} onCorrected={onAgain} />}
                {place !== null && <Place data={data} number={place} onPlace={onPlace} onFrame={onFrame} onLabels={setLabels} />}
                <Robots heard={heard} place={place} onPlace={onPlace} onFrame={onFrame} />
                <Evidence data={data} metric={scene.kind === "metric"} onPlace={onPlace} onFrame={onFrame} />
            </div>
        </div>
    </>;
}

/** The frame of the link, or the last one before it; without one, the first. */
function cursorOf(steps: Step[], frame: number | null): number {
    if (frame === null) return 0;
    const after = steps.findIndex(({ sequence }) => sequence > frame);
    return Math.max(after < 0 ? steps.length - 1 : after - 1, 0);
}

/** Left and right move the cursor, wherever nothing else wants them. */
function useKeys(by: (frames: number) => void, to: (end: "first" | "last") => void) {
    useEffect(() => {
        const pressed = (event: KeyboardEvent) => {
            const wanted = event.target instanceof Element && event.target.closest("input:not([type=checkbox]), select, textarea, dialog, .wide");
            if (wanted || event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
            const far = event.shiftKey ? 10 : 1;
            if (event.key === "ArrowLeft") by(-far);
            else if (event.key === "ArrowRight") by(far);
            else if (event.key === "Home") to("first");
            else if (event.key === "End") to("last");
            else return;
            event.preventDefault();
        };
        addEventListener("keydown", pressed);
        return () => removeEventListener("keydown", pressed);
    });
}

function GoTo({ data, onPlace }: { data: MapData; onPlace: (place: number) => void }) {
    const [missing, setMissing] = useState(false);
    const find = (wanted: string) => {
        const labelled = [...data.labels].find(([, label]) => label === wanted)?.[0];
        const numbered = /^\d{1,10}$/.test(wanted) && Number(wanted) < data.map.places ? Number(wanted) : undefined;
        const found = labelled ?? numbered;
        setMissing(found === undefined);
        if (found !== undefined) onPlace(found);
    };
    return (
        <form class="go-to" onSubmit={(event) => {
            event.preventDefault();
            find(String(new FormData(event.currentTarget).get("place")).trim());
        }}>
            <label>Go to place <input name="place" autoComplete="off" size={12} placeholder="number or label" aria-invalid={missing} onInput={() => setMissing(false)} /></label>
            <button type="submit">Go</button>
            {missing && <span class="refused" role="alert">No place has this number or label.</span>}
        </form>
    );
}

interface DrawingProps extends MapPageProps {
    data: MapData;
    scene: Scene;
    place: number | null;
    heard: Live;
    onPlace: (place: number) => void;
    onSeen: (view: View, size: Size) => void;
}

function Drawing({ data, scene, link, go, place, heard, onPlace, onSeen }: DrawingProps) {
    const kind = kindOf(data);
    const colour: Colour = link.colour ?? (kind === "appearance" ? "space" : data.sessions.length > 1 ? "session" : "time");
    const [corrected, setCorrected] = useState(link.corrected);
    useEffect(() => setCorrected(link.corrected), [link.corrected]);
    const marked = place === null ? null : (scene.near(place) ?? null);
    const seen = [
        ...heard.robots.map(({ guidance }) => guidance?.localization?.place_number ?? guidance?.appearance?.subgoal_place_number),
        ...heard.streaming.map(({ frame }) => frame.answer?.place_number),
    ];
    const where = seen.flatMap((number): [number, number][] => {
        const at = typeof number === "number" ? scene.near(number) : undefined;
        return at === undefined ? [] : [[scene.corrected.x[at]!, scene.corrected.y[at]!]];
    });
    const spots = JSON.stringify(where);
    const look = useMemo(() => ({ colour, corrected, place: marked, robots: where }), [colour, corrected, marked, spots]);
    const view = useMemo(() => link.view && { x: link.view[0], y: link.view[1], scale: link.view[2] }, [link.view]);
    const words = { metric: "in metres", topological: "places in their order, without metres", appearance: "a graph of what places look like" }[kind];
    const driven = data.places.length > 0 && kind === "topological";
    return (
        <section class="panel drawing" aria-label="The map">
            <header>
                <h2>Map</h2><span class="quiet" data-testid="kind">{words}</span>
                <label>Colour <select value={colour} onChange={(event) => go({ colour: event.currentTarget.value as Colour })}>
                    <option value="time">by time</option><option value="session">by session</option>
                    <option value="space">{kind === "metric" ? "by part" : "by space"}</option>
                </select></label>
                {driven && <label>Shape <select value={asDriven(data, link.shape) === ring ? "ring" : "strip"} onChange={(event) => go({ shape: event.currentTarget.value as Shape })}>
                    <option value="ring">ring</option><option value="strip">strip</option>
                </select></label>}
                {kind === "metric" && <label class="slider">wheels alone <input
                    type="range" min={0} max={1} step={0.05} value={corrected} aria-label="From odometry alone to corrected"
                    onInput={(event) => setCorrected(Number(event.currentTarget.value))}
                    onChange={(event) => go({ corrected: Number(event.currentTarget.value) })}
                /> corrected</label>}
            </header>
            {data.places.length === 0 ? <p class="empty">This map has no places yet: a robot makes them while it streams.</p> : (
                <MapCanvas
                    scene={scene} look={look} view={view}
                    describe={`Drawing of the map with ${plural(scene.numbers.length, "place")}. Plus and minus zoom, 0 shows all, shift and arrows move it.`}
                    onView={(view) => go({ view: view && [view.x, view.y, view.scale] })}
                    onPick={(index) => onPlace(scene.numbers[index]!)} onSeen={onSeen}
                />
            )}
            <p class="legend"><span class="key link">link</span><span class="key closure">loop closure; thicker is surer, dashed below 0.9</span>
                {kind === "metric" && corrected < 1 && <span class="key odometry">by wheels alone</span>}
                {data.every > 1 && <span data-testid="thinned">one of {data.every} places along the way; more where you zoom in</span>}
                {data.map.loop_closures > data.closures.length && <span>the first {count(data.closures.length)} closures</span>}
                {scene.unplaced > 0 && <span>{plural(scene.unplaced, "place")} without a pose not drawn</span>}
                {scene.parts > 1 && <span>{scene.parts} parts that nothing joins lie side by side</span>}
                {kind === "metric" && data.sessions.length > MOST_DRIVES && <span>ways of the first {MOST_DRIVES} sessions</span>}
            </p>
        </section>
    );
}
