// Maps laid on each other, as a merge proposes it or by hand: a scene like that of one map, coloured by the map that
// places are of.
import { all, at, type Merge, type Place, type Schemas, type Session } from "../rest";
import { compose, pose, type Pose } from "./geometry";
import { empty } from "./layout";
import type { Closure, Scene } from "./scene";

/** Places of one map, of one of its parts. */
export interface Layer {
    map: string;
    /** The part's frame in the drawing's. */
    frame: Pose;
    places: Place[];
    sessions: Session[];
    /** Whether the map has more places than are drawn. */
    cut: boolean;
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

/** Sessions of the target that the merge has brought from other maps. It tells them by what they are called there. */
export function broughtOf({ sources, target }: Merge): Set<string> {
    return new Set(sources.flatMap(({ sessions }) => sessions.map((session) => `${target}/sessions/${session}`)));
}

export async function overlaid(merge: Merge, signal: AbortSignal): Promise<Overlaid> {
    const measured = merge.sources.filter(({ overlap }) => overlap?.transformation);
    const part = measured[0]?.overlap?.target_part ?? 0;
    const shown = measured.filter(({ overlap }) => overlap!.target_part === part);
    // A base that was merged into holds what the others brought: that is not drawn twice.
    const brought = broughtOf(merge);
    const layer = async (map: string, of: number, frame: Pose): Promise<Layer> => {
        const loaded = await layerOf(map, signal);
        const own = ofPart(loaded, of).filter(({ frames }) => !brought.has(frames[0]?.session ?? ""));
        return { ...loaded, frame, places: own };
    };
    const layers = await Promise.all([
        layer(baseOf(merge), part, ORIGIN),
        ...shown.map(({ map, overlap }) => layer(map, overlap!.source_part, pose(overlap!.transformation) ?? ORIGIN)),
    ]);
    const matches = new Map(merge.sources.map(({ map, overlap }) => [map, overlap?.strongest_matches ?? []]));
    return laid(layers, merge.sources.map(({ map }) => map), matches);
}

/** Maps as they are loaded: how they lie is not said yet. */
export function loadLayers(maps: string[], signal: AbortSignal): Promise<Layer[]> {
    return Promise.all(maps.map(async (map) => {
        const loaded = await layerOf(map, signal);
        return { ...loaded, places: ofPart(loaded, largestPart(loaded)) };
    }));
}

/** Loaded maps, each laid as a person says, by its largest part. */
export function laidByHand(layers: Layer[], frames: Pose[]): Overlaid {
    const shown = layers.filter(({ places }) => places.length > 0);
    return laid(shown.map((layer) => ({ ...layer, frame: frames[layers.indexOf(layer)] ?? ORIGIN })), layers.map(({ map }) => map), new Map());
}

async function layerOf(map: string, signal: AbortSignal): Promise<Layer> {
    const [places, sessions] = await Promise.all([
        all<"places", Place>(`${at(map)}/places`, "places", signal, MOST_PLACES),
        all<"sessions", Session>(`${at(map)}/sessions`, "sessions", signal),
    ]);
    return { map, frame: ORIGIN, sessions, places, cut: places.length >= MOST_PLACES };
}

/** Places with metres of a part. */
function ofPart({ places }: Layer, part: number | undefined): Place[] {
    return places.filter((place) => place.pose?.part === part && pose(place.pose?.pose));
}

function largestPart({ places }: Layer): number | undefined {
    const sizes = new Map<number, number>();
    for (const { pose } of places) if (pose) sizes.set(pose.part, (sizes.get(pose.part) ?? 0) + 1);
    return [...sizes].sort(([, one], [, other]) => other - one)[0]?.[0];
}

type Matches = Map<string, Schemas["MapOverlap"]["strongest_matches"]>;

function laid(layers: Layer[], wanted: string[], matches: Matches): Overlaid {
    const names = new Set(layers.map(({ map }) => map));
    return {
        scene: sceneOf(layers, matches),
        layerOf: layers.flatMap(({ places }, layer) => places.map(() => layer)),
        maps: layers.map(({ map, sessions }) => ({ map, sessions })),
        sessionOf: layers.flatMap(({ places }) => places.map(({ frames }) => frames[0]?.session ?? "")),
        absent: wanted.filter((map) => !names.has(map)),
        cut: layers.some(({ cut }) => cut),
    };
}

function sceneOf(layers: Layer[], matchesOf: Matches): Scene {
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
        const matches = matchesOf.get(map) ?? [];
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
