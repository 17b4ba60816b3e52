// The maps that there are and the robots in them, asked for again and again: who looks after robots leaves the list open.
import { all, at, streams, type Navigation, type WayMap } from "../rest";
import { usePolled, type Polled } from "../parts";
import { newestOf } from "./hour";

const LOOK_MS = 3000;

/** Robots in one map. */
export interface Present {
    /** Those that are led, and have a stream open. */
    led: number;
    /** Streams into sessions. */
    streaming: number;
}

export interface Listed {
    map: WayMap;
    present: Present;
}

/** All maps as they are now; with other `changes`, at once. */
export function useMaps(changes: number): Polled<Listed[]> {
    return usePolled(look, () => LOOK_MS, [changes]);
}

async function look(signal: AbortSignal): Promise<Listed[]> {
    const [maps, open] = await Promise.all([all<"maps", WayMap>("/v1/maps", "maps", signal), streams("", signal)]);
    // Where the server leads nobody at all, no map need be asked; without a word of its metrics, each is.
    const some = newestOf("waypost_robots_led") !== 0;
    return Promise.all(maps.map(async (map) => {
        const robots = some ? await all<"navigations", Navigation>(`${at(map.name)}/navigations`, "navigations", signal) : [];
        const led = robots.filter(({ connected }) => connected).length;
        return { map, present: { led, streaming: open.filter(({ session }) => session.startsWith(`${map.name}/sessions/`)).length } };
    }));
}
