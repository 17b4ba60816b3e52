// Which robots are in the maps of a list now. Maps are asked for as a whole; one by one only where something happens.
import { useEffect, useState } from "preact/hooks";
import { all, at, type Navigation, type Session, type WayMap } from "../rest";
import { newestOf } from "./hour";

const LOOK_MS = 5000;
/** A robot that streams sends frames every few seconds. */
const STREAMS_MS = 10_000;

/** Robots in one map. */
export interface Present {
    /** Those that are led, and have a stream open. */
    led: number;
    /** Sessions that came by a frame lately. */
    streaming: number;
}

/** What was seen of a map's sessions before. */
interface Seen {
    frames: number;
    sequences: Map<string, number>;
    grew_ms: Map<string, number>;
}

/** Robots by the map's name; a map is missing until it was looked at. */
export function usePresent(listed: string): Map<string, Present> {
    const [present, setPresent] = useState(new Map<string, Present>());
    useEffect(() => {
        const gone = new AbortController();
        const seen = new Map<string, Seen>();
        let timer = 0;
        const look = async () => {
            // What failed shows what was; the next look asks again.
            if (document.visibilityState === "visible") await lookAt(seen, gone.signal).then((found) => gone.signal.aborted || setPresent(found), () => {});
            if (!gone.signal.aborted) timer = window.setTimeout(look, LOOK_MS);
        };
        void look();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [listed]);
    return present;
}

async function lookAt(seen: Map<string, Seen>, signal: AbortSignal): Promise<Map<string, Present>> {
    const maps = await all<"maps", WayMap>("/v1/maps", "maps", signal);
    // Where the server leads nobody at all, no map need be asked; without a word of its metrics, each is.
    const some = newestOf("waypost_robots_led") !== 0;
    const found = new Map<string, Present>();
    for (const map of maps) {
        const robots = some ? await all<"navigations", Navigation>(`${at(map.name)}/navigations`, "navigations", signal) : [];
        found.set(map.name, { led: robots.filter(({ connected }) => connected).length, streaming: await streaming(map, seen, signal) });
    }
    return found;
}

/** Sessions that have grown since the last looks. */
async function streaming(map: WayMap, seen: Map<string, Seen>, signal: AbortSignal): Promise<number> {
    const before = seen.get(map.name);
    const now = performance.now();
    const grew_ms = new Map([...(before?.grew_ms ?? [])].filter(([, at_ms]) => now - at_ms < STREAMS_MS));
    let sequences = before?.sequences ?? new Map<string, number>();
    if (before?.frames !== map.frames) {
        const sessions = await all<"sessions", Session>(`${at(map.name)}/sessions`, "sessions", signal);
        const next = new Map(sessions.map(({ name, last_sequence }) => [name, last_sequence ?? -1]));
        for (const [name, last] of next) {
            if (before && last > (before.sequences.get(name) ?? -1)) grew_ms.set(name, now);
        }
        sequences = next;
    }
    seen.set(map.name, { frames: map.frames, sequences, grew_ms });
    return grew_ms.size;
}
