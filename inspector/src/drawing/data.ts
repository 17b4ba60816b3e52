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
    /** Of so many frames only the first is here. */
    every: number;
}

export interface MapData {
    map: WayMap;
    /** Of large maps those whose number `every` divides, and those that were asked for besides; by number. */
    places: Place[];
    every: number;
    /** A place, if it is among them. */
    placeOf: (number: number) => Place | undefined;
    sessions: Session[];
    closures: LoopClosure[];
    labels: Map<number, string>;
    drives: Map<string, Drive>;
    graph: AppearanceGraph | null;
}

/** Most sessions whose way is drawn: each is asked for by itself. */
export const MOST_DRIVES = 40;

/** How much of a map is asked for at once. */
interface Most {
    /** Of more places, every so many-th along the way; so of all frames of ways. */
    places: number;
    rows: number;
    closures: number;
    /** Graphs of more places are not laid out. */
    graph: number;
}

const MOST_PLACES = 10_000;
const WHOLE: Most = { places: MOST_PLACES, rows: 20_000, closures: 10_000, graph: Infinity };
/** For a picture of 300 pixels. */
export const SMALL: Most = { places: 2500, rows: 5000, closures: 1, graph: 2500 };

export async function load(name: string, signal: AbortSignal, most = WHOLE): Promise<MapData> {
    const base = at(`maps/${name}`);
    const map = await get<WayMap>(base, signal);
    const every = Math.max(Math.ceil(map.places / most.places), 1);
    const [places, sessions, closures, labels] = await Promise.all([
        all<"places", Place>(`${base}/places`, "places", signal, Infinity, every > 1 ? { every } : {}),
        all<"sessions", Session>(`${base}/sessions`, "sessions", signal),
        all<"loop_closures", LoopClosure>(`${base}/loop-closures`, "loop_closures", signal, most.closures),
        all<"labels", Schemas["PlaceLabel"]>(`${base}/labels`, "labels", signal),
    ]);
    const byLooks = map.settings?.navigation_strategy === "appearance";
    const graph = byLooks && places.length && map.places <= most.graph ? await get<AppearanceGraph>(`${base}/appearance-graph`, signal) : null;
    const metric = !graph && places.some((place) => place.pose);
    // A session of no place with a pose drove without odometry; of thinned places that cannot be told.
    const driven = new Set(places.filter((place) => place.pose).flatMap((place) => place.frames.map(({ session }) => session)));
    const mayHaveDriven = ({ name }: Session) => every > 1 || driven.has(name);
    const drives = metric ? await drivesOf(sessions.filter(mayHaveDriven).slice(0, MOST_DRIVES), most.rows, signal) : new Map<string, Drive>();
    const labelled = new Map(labels.map(({ place, label }) => [numberOf(place), label]));
    return withPlaces({ map, every, sessions, closures, labels: labelled, drives, graph }, places);
}

/** The same map with places. */
export function withPlaces(data: Omit<MapData, "places" | "placeOf">, places: Place[]): MapData {
    const by = new Map(places.map((place) => [numberOf(place.name), place]));
    return { ...data, places, placeOf: (number) => by.get(number) };
}

/** With places that were asked for besides, each once and by number: what was there is as new, or newer. */
export function withMore(data: MapData, more: Place[]): MapData {
    const by = new Map([...more, ...data.places].map((place) => [numberOf(place.name), place]));
    return withPlaces(data, [...by].sort(([a], [b]) => a - b).map(([, place]) => place));
}

/** A stretch of a large map: numbers, or a rectangle of a part. */
export type Stretch = Record<"from_place_number" | "to_place_number", number> |
    Record<"part" | "min_x_m" | "max_x_m" | "min_y_m" | "max_y_m", number>;

/** Places of a large map where somebody looks closely. */
export async function closer(name: string, every: number, stretches: Stretch[], signal: AbortSignal): Promise<Place[]> {
    const found = await Promise.all(stretches.map((stretch) =>
        all<"places", Place>(`${at(name)}/places`, "places", signal, MOST_PLACES, { every, ...stretch })));
    return found.flat();
}

function numberOf(name: string): number {
    return Number(short(name));
}

async function drivesOf(sessions: Session[], rows: number, signal: AbortSignal): Promise<Map<string, Drive>> {
    const every = Math.max(Math.ceil(sessions.reduce((sum, { frames }) => sum + frames, 0) / rows), 1);
    const thinned = every > 1 ? `&every=${every}` : "";
    const drives = await Promise.all(sessions.map(async ({ name }) => {
        const [corrected, odometry] = await Promise.all(["map", "odom"].map((frame) =>
            way(`${at(name)}/trajectory?frame=${frame}${thinned}`, signal)));
        return [name, { corrected: corrected!, odometry: odometry!, every }] as const;
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
