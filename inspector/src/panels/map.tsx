// One map: its drawing, its time, the frame under the cursor and the place that it shows. One cursor drives all.
import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { load, type MapData } from "../drawing/data";
import type { Go, Link } from "../link";
import { at, get, short, type Place as PlaceRecord } from "../rest";
import { compare, type Sequence } from "../sequence";
import { forgetPictures, keepsPictures, plural, Renewals, Shown, useAsked, useNarrow } from "../parts";
import { Drawing } from "./drawing";
import { Evidence } from "./evidence";
import { Matrix } from "./matrix";
import { Pair } from "./pair";
import { Place } from "./place";
import { useCloser } from "./closer";
import { Leading } from "./leading";
import { useFresh, useLive } from "./live";
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
    const again = () => {
        // Pictures show what was said of a frame, and the map may be another by now.
        forgetPictures();
        setAsks(asks + 1);
    };
    return (
        <main class="map" id="content">
            <Shown asked={asked} what={`the map ${link.map}`}>
                {(data) => <Loaded key={`${data.map.name} ${asks}`} given={data} link={link} go={go} onAgain={again} />}
            </Shown>
        </main>
    );
}

function Loaded({ given, link, go, onAgain }: MapPageProps & { given: MapData; onAgain: () => void }) {
    const { data, renewals, stale, refresh, renew, setLabels } = useFresh(given);
    const { map, sessions } = data;
    const session = sessions.find(({ name }) => short(name) === link.session) ?? sessions[0] ?? null;
    const { steps, whole, more, error, hear } = useSteps(session, link.frame, renewals);
    const cursor = cursorOf(steps, link.frame);
    const coming = (!whole || more[1]) && link.frame !== null && isAhead(steps, link.frame);
    const step = coming ? null : (steps[cursor] ?? null);
    const place = link.place ?? step?.place ?? null;
    const strayed = strayedTo(link, session && short(session.name), coming ? null : step);
    const heard = useLive(map.name, {
        renew: (anotherLog) => void renew(anotherLog),
        frames: (frames) => {
            hear(frames);
            refresh();
        },
    });
    const newest = link.follow ? heard.streaming.at(-1) : undefined;
    const known = newest && sessions.some(({ name }) => name === newest.session);
    useEffect(() => {
        if (newest && known) go({ session: short(newest.session), frame: short(newest.frame.name), place: null });
    }, [newest?.frame.name, known]);
    const narrow = useNarrow();
    const { closer, scene, onSeen } = useCloser(data, renewals, link.shape);

    // Keys may come faster than the page is drawn: each goes on from the one before.
    const latest = useRef(cursor);
    useLayoutEffect(() => {
        latest.current = cursor;
    }, [cursor]);
    const toFrame = (frame: Sequence) =>
        go({ frame, place: null, beside: null, follow: false, session: session ? short(session.name) : null });
    const onCursor = (index: number | "first" | "last") => {
        const end = index === "first" ? session?.first_sequence : index === "last" ? session?.last_sequence : null;
        if (typeof end === "string" && (more[0] || more[1])) return toFrame(end);
        const wanted = index === "first" ? 0 : index === "last" ? steps.length - 1 : index;
        const nearest = Math.min(Math.max(wanted, 0), steps.length - 1);
        const to = steps[nearest];
        if (to) latest.current = nearest;
        if (to) toFrame(to.sequence);
    };
    const onFrame = (session: string, frame: Sequence) => go({ session: short(session), frame, place: null, beside: null, follow: false });
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
    // Where no robot streams, who follows goes with one that is led.
    const led = link.follow && !newest ? (heard.robots.find(({ connected, guidance }) => connected && guidance?.localization)?.guidance?.localization?.place_number ?? null) : null;
    useEffect(() => {
        let gone = false;
        if (led !== null) void framesOf(led).then(([first]) => {
            if (!gone) go({ place: led, beside: null, ...(first && { session: short(first.session), frame: first.sequence }) });
        });
        return () => {
            gone = true;
        };
    }, [led]);
    useKeys((by) => onCursor(latest.current + by), onCursor);
    const robots = <Robots heard={heard} place={place} onPlace={onPlace} onFrame={onFrame} />;
    return <Renewals.Provider value={renewals}>
        <div class="title">
            <h1>{short(map.name)}</h1>
            <p class="quiet">
                {plural(map.places, "place")} · {plural(map.links, "link")} · {plural(map.loop_closures, "loop closure")}{map.withdrawn_loop_closures > 0 && `, ${map.withdrawn_loop_closures} withdrawn`} · {plural(map.frames, "frame")}
            </p>
            <GoTo data={data} onPlace={onPlace} />
            <label class="choice" title="The cursor goes with the newest frame, or with a robot that is led"><input type="checkbox" checked={link.follow} onChange={(event) => go({ follow: event.currentTarget.checked })} /> <span>follow</span></label>
            <button type="button" onClick={onAgain}>Load anew</button>
        </div>
        <Leading robots={heard.robots} onPlace={onPlace} />
        <div class="columns">
            <div class="broad">
                <Drawing data={data} scene={scene} link={link} go={go} place={place} heard={heard} narrow={narrow} onPlace={onPlace} onSeen={onSeen} />
                {strayed && <p class="refused" role="alert">{strayed}</p>}
                {narrow && robots}
                {session && (
                    <Time
                        sessions={sessions} session={session} steps={steps} whole={whole} more={more} error={error} cursor={cursor}
                        threshold={map.settings?.closure_threshold ?? null} pictures={keepsPictures(map)} onCursor={onCursor}
                        onSession={(name) => go({ session: short(name), frame: null, place: null, beside: null, follow: false })}
                        onDeleted={() => {
                            go({ session: null, frame: null, place: null });
                            onAgain();
                        }}
                    />
                )}
                <Matrix data={closer} link={link} go={go} onPair={onPair} onPlace={onPlace} />
            </div>
            <div class="narrow">
                {session && step && <Pair session={session.name} step={step} pictures={keepsPictures(map)} beside={link.beside} large={link.large} follow={link.follow} onLarge={(large) => go({ large })} onPlace={onPlace} onCorrected={onAgain} />}
                {place !== null && <Place data={data} stale={stale} number={place} onPlace={onPlace} onFrame={onFrame} onLabels={setLabels} />}
                {!narrow && robots}
                <Evidence data={data} metric={scene.kind === "metric"} onPlace={onPlace} onFrame={onFrame} />
            </div>
        </div>
    </Renewals.Provider>;
}

/** What a link asks for that is not there (any more), and what is shown in its place. */
function strayedTo({ session, frame }: Link, shown: string | null, step: Step | null): string | null {
    if (session !== null && session !== shown) return `This map has no session ${session}${shown === null ? "." : `: this is ${shown}.`}`;
    if (frame !== null && step && step.sequence !== frame) return `${shown} has no frame ${frame}: this is frame ${step.sequence}.`;
    return null;
}

/** Whether a frame comes after all of these. */
function isAhead(steps: Step[], frame: Sequence): boolean {
    const last = steps.at(-1);
    return !last || compare(frame, last.sequence) > 0;
}

/** The frame of the link, or the last one before it; without one, the first. */
function cursorOf(steps: Step[], frame: Sequence | null): number {
    if (frame === null) return 0;
    const after = steps.findIndex(({ sequence }) => compare(sequence, frame) > 0);
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
