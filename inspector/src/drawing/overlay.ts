// Maps laid on each other as a merge proposes it: a scene like that of one map, coloured by the map that places are of.
import { all, at, type Merge, type Place, type Session } from "../rest";
import { compose, pose, type Pose } from "./geometry";
import { empty } from "./layout";
import type { Closure, Scene } from "./scene";

/** Places of one map, of the part that the merge speaks of. */
interface Layer {
    map: string;
    /** The part's frame in the drawing's. */
    frame: Pose;
    places: Place[];
    sessions: Session[];
}

export interface Overlaid {
    scene: Scene;
    /** The map that the place at each index is of. */
    layerOf: number[];
    /** The maps in the order of their colours, the one that the others are laid on first, with their sessions. */
    maps: { map: string; sessions: Session[] }[];
    /** The session that made the place at each index; empty if none is known. */
    sessionOf: string[];
    /** Maps that lie on another part, or have no metres. */
    absent: string[];
    /** Whether a map has more places than are drawn. */
    cut: boolean;
}

const MOST_PLACES = 5000;

/** The number of a map's colour: the second is left out, for it is too much like that of matches. */
export function colourNumber(layer: number): number {
    return layer === 0 ? 0 : 2 + ((layer - 1) % 6);
}

const ORIGIN: Pose = { x: 0, y: 0, heading: 0 };

/** The map that the others are laid on. */
export function baseOf({ base, target }: Merge): string {
    return base?.map ?? target;
}

/** All maps that become one, but for a target that was there before. */
export function partsOf({ base, sources }: Merge): string[] {
    return [...(base ? [base] : []), ...sources].map(({ map }) => map);
}

export async function overlaid(merge: Merge, signal: AbortSignal): Promise<Overlaid> {
    const measured = merge.sources.filter(({ overlap }) => overlap?.transformation);
    const part = measured[0]?.overlap?.target_part ?? 0;
    const shown = measured.filter(({ overlap }) => overlap!.target_part === part);
    const base = baseOf(merge);
    // A base that was merged into holds what the others brought: that is not drawn twice.
    const brought = new Set(merge.sources.flatMap(({ sessions }) => sessions));
    const layer = async (map: string, of: number, frame: Pose): Promise<Layer & { cut: boolean }> => {
        const [places, sessions] = await Promise.all([
            all<"places", Place>(`${at(map)}/places`, "places", signal, MOST_PLACES),
            all<"sessions", Session>(`${at(map)}/sessions`, "sessions", signal),
        ]);
        const own = places.filter((place) => place.pose?.part === of && pose(place.pose.pose) && !brought.has(place.frames[0]?.session ?? ""));
        return { map, frame, sessions, places: own, cut: places.length >= MOST_PLACES };
    };
    const layers = await Promise.all([
        layer(base, part, ORIGIN),
        ...shown.map(({ map, overlap }) => layer(map, overlap!.source_part, pose(overlap!.transformation) ?? ORIGIN)),
    ]);
    const names = new Set(shown.map(({ map }) => map));
    return {
        scene: sceneOf(layers, merge),
        layerOf: layers.flatMap(({ places }, layer) => places.map(() => layer)),
        maps: layers.map(({ map, sessions }) => ({ map, sessions })),
        sessionOf: layers.flatMap(({ places }) => places.map(({ frames }) => frames[0]?.session ?? "")),
        absent: merge.sources.map(({ map }) => map).filter((map) => !names.has(map)),
        cut: layers.some(({ cut }) => cut),
    };
}

function sceneOf(layers: Layer[], merge: Merge): Scene {
    const laid = layers.flatMap(({ places, frame }, layer) => places.map((place) => ({
        layer, place, number: numberOf(place), ...compose(frame, pose(place.pose!.pose)!),
    })));
    const points = empty(laid.length);
    const index = new Map<string, number>();
    laid.forEach(({ layer, number, x, y }, at) => {
        points.x[at] = x;
        points.y[at] = y;
        index.set(`${layer}/${number}`, at);
    });
    const links = laid.flatMap(({ layer, place, number }, from) => place.linked_place_numbers.flatMap((other): [number, number][] => {
        const to = index.get(`${layer}/${other}`);
        return to === undefined || other <= number ? [] : [[from, to]];
    }));
    const closures = layers.flatMap(({ map }, layer) => {
        const matches = merge.sources.find((source) => source.map === map)?.overlap?.strongest_matches ?? [];
        return matches.flatMap(({ source_place_number, target_place_number, posterior }): Closure[] => {
            const [from, to] = [index.get(`${layer}/${source_place_number}`), index.get(`0/${target_place_number}`)];
            if (layer === 0 || from === undefined || to === undefined) return [];
            const here: [number, number] = [points.x[from]!, points.y[from]!];
            return [{ probability: posterior, to, corrected: here, odometry: here }];
        });
    });
    return {
        kind: "metric", numbers: laid.map(({ number }) => number), indexOf: new Map(), corrected: points, odometry: points,
        unplaced: 0, parts: 1, layered: true, links, closures, tracks: [], labels: [], apart: new Map(), near: () => undefined, count: laid.length,
        sessionOf: Uint16Array.from(laid, ({ layer }) => colourNumber(layer)), spaceOf: new Uint32Array(laid.length),
    };
}

function numberOf({ name }: Place): number {
    return Number(name.slice(name.lastIndexOf("/") + 1));
}
