// What is known of one map, as REST tells it, before it is drawn.
import {
    all, at, get, Refusal, short, text, type AppearanceGraph, type LoopClosure, type Place, type Schemas, type Session,
    type WayMap,
} from "../rest";
import { trajectory, type Stamped } from "./geometry";

/** How a session drove: by the map, and by its wheels. */
export interface Drive {
    corrected: Stamped[];
    odometry: Stamped[];
}

export interface MapData {
    map: WayMap;
    places: Place[];
    sessions: Session[];
    closures: LoopClosure[];
    labels: Map<number, string>;
    drives: Map<string, Drive>;
    graph: AppearanceGraph | null;
}

/** Most sessions whose way is drawn: each is asked for by itself. */
export const MOST_DRIVES = 40;

export async function load(name: string, signal: AbortSignal): Promise<MapData> {
    const base = at(`maps/${name}`);
    const [map, places, sessions, closures, labels] = await Promise.all([
        get<WayMap>(base, signal),
        all<"places", Place>(`${base}/places`, "places", signal),
        all<"sessions", Session>(`${base}/sessions`, "sessions", signal),
        all<"loop_closures", LoopClosure>(`${base}/loop-closures`, "loop_closures", signal),
        all<"labels", Schemas["PlaceLabel"]>(`${base}/labels`, "labels", signal),
    ]);
    const byLooks = map.settings?.navigation_strategy === "appearance";
    const graph = byLooks && places.length ? await get<AppearanceGraph>(`${base}/appearance-graph`, signal) : null;
    const metric = !graph && places.some((place) => place.pose);
    const drives = metric ? await drivesOf(sessions.slice(0, MOST_DRIVES), signal) : new Map<string, Drive>();
    const labelled = new Map(labels.map(({ place, label }) => [Number(short(place)), label]));
    return { map, places, sessions, closures, labels: labelled, drives, graph };
}

async function drivesOf(sessions: Session[], signal: AbortSignal): Promise<Map<string, Drive>> {
    const drives = await Promise.all(sessions.map(async ({ name }) => {
        const [corrected, odometry] = await Promise.all([
            way(`${at(name)}/trajectory?frame=map`, signal),
            way(`${at(name)}/trajectory?frame=odom`, signal),
        ]);
        return [name, { corrected, odometry }] as const;
    }));
    return new Map(drives);
}

/** A way; a session without odometry has none. */
async function way(path: string, signal: AbortSignal): Promise<Stamped[]> {
    try {
        return trajectory(await text(path, signal));
    } catch (error) {
        if (error instanceof Refusal && error.code === "failed_precondition") return [];
        throw error;
    }
}
