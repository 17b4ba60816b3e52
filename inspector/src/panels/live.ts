// A map while robots are in it: frames as they are decided, robots as they move, the drawing as it grows.
import { useEffect, useRef, useState } from "preact/hooks";
import { load, type MapData } from "../drawing/data";
import { follow } from "../events";
import { forgetPictures, usePolled } from "../parts";
import { at, get, short, streams, type FrameRecord, type OpenStream, type WayMap } from "../rest";
import { useRobots, type Led } from "./led";

/** How soon a stream that was opened or has ended shows, and where a robot is that only looks. */
const STREAMS_EVERY_MS = 1000;

/** The newest frame of a session that a robot streams into. */
export interface Streaming {
    session: string;
    frame: FrameRecord;
    heard_ms: number;
    /** Frames that were heard of, and those whose place was recognised. */
    frames: number;
    recognitions: number;
}

/** A robot that streams sends frames every few seconds. */
const STREAMS_MS = 10_000;
const MOST_STREAMING = 64;
/** Frames may come faster than the page is drawn. */
const DRAW_MS = 250;

export interface Live {
    robots: Led[];
    /** The one that was heard last comes last. */
    streaming: Streaming[];
    /** Streams that are open. Of a robot that only looks, nothing else is heard: the map keeps none of its frames. */
    open: OpenStream[];
    live: boolean;
    error: Error | null;
}

interface Hearing {
    /** Frames that were decided, oldest first. */
    frames: (frames: FrameRecord[]) => void;
    /** What was asked for may be out of date, and is if the map has another log by now. */
    renew: (anotherLog: boolean) => void;
}

/** What happens in a map for as long as this is shown. Holds the newest frame of a session, and those not drawn yet. */
export function useLive(map: string, hearing: Hearing): Live {
    const [{ live, error }, setLive] = useState<{ live: boolean; error: Error | null }>({ live: false, error: null });
    const [streaming, setStreaming] = useState<Streaming[]>([]);
    const { robots, error: unheard, hear } = useRobots(map, live);
    const { value: open } = usePolled((signal) => streams(short(map), signal), () => STREAMS_EVERY_MS, [map]);
    const to = useRef({ ...hearing, hear });
    to.current = { ...hearing, hear };
    useEffect(() => {
        const gone = new AbortController();
        let waiting: FrameRecord[] = [];
        let timer = 0;
        const draw = () => {
            timer = 0;
            const frames = waiting;
            waiting = [];
            to.current.frames(frames);
            setStreaming((known) => newest(known, frames));
        };
        const fade = window.setInterval(() => setStreaming((known) => known.length ? newest(known, []) : known), STREAMS_MS / 4);
        void follow(map, {
            renew: (anotherLog) => {
                // Frames that were heard of before tell numbers of places that mean others by now.
                if (anotherLog) {
                    waiting = [];
                    setStreaming([]);
                }
                to.current.renew(anotherLog);
            },
            live: (live, error) => setLive({ live, error }),
            hear: ({ frame, navigation }) => {
                if (navigation) to.current.hear(navigation);
                if (frame?.frame) waiting.push(frame.frame);
                if (waiting.length && !timer) timer = window.setTimeout(draw, DRAW_MS);
            },
        }, gone.signal);
        return () => {
            gone.abort();
            clearTimeout(timer);
            clearInterval(fade);
        };
    }, [map]);
    return { robots, streaming, open: open ?? [], live, error: unheard ?? (live ? null : error) };
}

function newest(known: Streaming[], frames: FrameRecord[]): Streaming[] {
    const now = performance.now();
    const by = new Map(known.filter(({ heard_ms }) => now - heard_ms < STREAMS_MS).map((one) => [one.session, one]));
    for (const frame of frames) {
        const session = sessionOf(frame);
        const before = by.get(session);
        const known = frame.answer?.reason === "same_place" || frame.answer?.reason === "loop_closure";
        by.delete(session);
        by.set(session, {
            session, frame, heard_ms: now,
            frames: (before?.frames ?? 0) + 1, recognitions: (before?.recognitions ?? 0) + (known ? 1 : 0),
        });
    }
    return [...by.values()].slice(-MOST_STREAMING);
}

/** The session of a frame, as maps/{map}/sessions/{session}. */
export function sessionOf({ name }: FrameRecord): string {
    return name.split("/").slice(0, 4).join("/");
}

/** A map is asked for anew no sooner than this after it grew, and never for more than a sixth of the time. */
const REFRESH_MS = 2000;
const REST_TIMES = 5;

/** What changes whenever a map does, but for its labels. */
const edition = ({ create_time_ns, places, links, sessions, frames, loop_closures, withdrawn_loop_closures }: WayMap) =>
    JSON.stringify([create_time_ns, places, links, sessions, frames, loop_closures, withdrawn_loop_closures]);

/** A map's data, and what has them asked for anew behind what is shown. They are stale from a renewal until they are here. */
export function useFresh(given: MapData) {
    const [data, setData] = useState(given);
    const [renewals, setRenewals] = useState(0);
    const latest = useRef(data);
    latest.current = data;
    // What is shown was asked for after so many renewals.
    const [shown, setShown] = useState(0);
    const state = useRef({ renewals: 0, shown: 0, busy: false, wanted: false, rest_ms: 0, edits: 0, timer: 0, gone: new AbortController() });
    const refresh = () => {
        const now = state.current;
        now.wanted = true;
        if (now.busy) return;
        now.busy = true;
        now.timer = window.setTimeout(async () => {
            now.wanted = false;
            const [began, edits, renewals] = [performance.now(), now.edits, now.renewals];
            try {
                const next = await load(short(given.map.name), now.gone.signal);
                // A label that was written meanwhile is newer than what was read.
                setData((before) => now.edits === edits ? next : { ...next, labels: before.labels });
                setShown(now.shown = renewals);
            } catch {
                // What is shown stays; the next frame asks again.
            }
            now.rest_ms = Math.max(REFRESH_MS, REST_TIMES * (performance.now() - began));
            now.busy = false;
            if (now.wanted && !now.gone.signal.aborted) refresh();
        }, now.rest_ms);
    };
    /** Where the map is another by now, it is asked for anew, and so is all that is shown of it. */
    const renew = async (anotherLog: boolean) => {
        const now = state.current;
        if (!anotherLog) {
            const map = await get<WayMap>(at(given.map.name), now.gone.signal).catch(() => null);
            if (map === null || now.gone.signal.aborted || edition(map) === edition(latest.current.map)) return;
        }
        forgetPictures();
        setRenewals(++now.renewals);
        refresh();
    };
    useEffect(() => {
        const now = state.current;
        return () => {
            now.gone.abort();
            clearTimeout(now.timer);
        };
    }, []);
    const setLabels = (labels: MapData["labels"]) => {
        // They were written by numbers that mean other places by now: the server knows which.
        if (state.current.shown !== state.current.renewals) return refresh();
        state.current.edits++;
        setData((before) => ({ ...before, labels }));
    };
    return { data, renewals, stale: shown !== renewals, refresh, renew, setLabels };
}
