// Which robots are in the maps of a list now. Streams are asked for as a whole; robots that are led, by map.
import { useEffect, useState } from "preact/hooks";
import { all, at, streams, type Navigation, type WayMap } from "../rest";
import { newestOf } from "./hour";

const LOOK_MS = 2000;

/** Robots in one map. */
export interface Present {
    /** Those that are led, and have a stream open. */
    led: number;
    /** Streams into sessions. */
    streaming: number;
}

/** Robots by the map's name; a map is missing until it was looked at. */
export function usePresent(listed: string): Map<string, Present> {
    const [present, setPresent] = useState(new Map<string, Present>());
    useEffect(() => {
        const gone = new AbortController();
        let timer = 0;
        const look = async () => {
            // What failed shows what was; the next look asks again.
            if (document.visibilityState === "visible") await lookAt(gone.signal).then((found) => gone.signal.aborted || setPresent(found), () => {});
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

async function lookAt(signal: AbortSignal): Promise<Map<string, Present>> {
    const [maps, open] = await Promise.all([all<"maps", WayMap>("/v1/maps", "maps", signal), streams("", signal)]);
    // Where the server leads nobody at all, no map need be asked; without a word of its metrics, each is.
    const some = newestOf("waypost_robots_led") !== 0;
    const found = new Map<string, Present>();
    for (const { name } of maps) {
        const robots = some ? await all<"navigations", Navigation>(`${at(name)}/navigations`, "navigations", signal) : [];
        found.set(name, {
            led: robots.filter(({ connected }) => connected).length,
            streaming: open.filter(({ session }) => session.startsWith(`${name}/sessions/`)).length,
        });
    }
    return found;
}
