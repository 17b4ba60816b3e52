// What of a map is drawn, and where: points, pairs and ways, without pixels.
import type { Shape } from "../link";
import type { LoopClosure } from "../rest";
import { short } from "../rest";
import { compare, type Sequence } from "../sequence";
import type { Drive, MapData } from "./data";
import { compose, inverse, pose, rowOf, until, type Stamped } from "./geometry";
import { byLooks, empty, ring, strip, type Points } from "./layout";

export type Kind = "metric" | "topological" | "appearance";

export interface Track {
    session: number;
    corrected: Points;
    odometry: Points;
}

export interface Closure {
    probability: number;
    to: number;
    corrected: [number, number];
    odometry: [number, number];
}

export interface Scene {
    kind: Kind;
    /** Number of the place at each index, and back. */
    numbers: number[];
    indexOf: Map<number, number>;
    corrected: Points;
    /** The same by the wheels alone; what has none stays where it is. */
    odometry: Points;
    /** Places of the map that it does not know where to put. */
    unplaced: number;
    parts: number;
    links: [number, number][];
    closures: Closure[];
    tracks: Track[];
    sessionOf: Uint16Array;
    spaceOf: Uint32Array;
    labels: [number, string][];
    /** How far each part of the map was moved to the right. */
    apart: Map<number, number>;
    /** The index of a place, or of the last one before it where not all are drawn. */
    near: (number: number) => number | undefined;
    /** Places of the map, drawn or not: what their numbers are a share of. */
    count: number;
    /** Whether maps lie on each other: then what is below is drawn larger, so that it shows. */
    layered?: boolean;
}

const NS = 1e9;
/** Between parts of a map that nothing joins, as a share of their size. */
const PART_GAP = 0.15;

export function kindOf({ graph, places }: MapData): Kind {
    if (graph) return "appearance";
    return places.some((place) => place.pose) ? "metric" : "topological";
}

export function sceneOf(data: MapData, shape: Shape | null): Scene {
    const kind = kindOf(data);
    const shown = kind === "metric" ? data.places.filter((place) => pose(place.pose?.pose)) : data.places;
    const numbers = shown.map((place) => Number(short(place.name)));
    const indexOf = new Map(numbers.map((number, index) => [number, index]));
    const sessionNumbers = new Map(data.sessions.map(({ name }, index) => [name, index]));
    const sessionOf = Uint16Array.from(shown, (place) => sessionNumbers.get(place.frames[0]?.session ?? "") ?? 0);
    const near = (number: number) => indexOf.get(number) ?? indexOf.get(number - (number % data.every));
    const links = shown.flatMap((place, index): [number, number][] =>
        place.linked_place_numbers.flatMap((number): [number, number][] => {
            const other = near(number);
            // Of two places that are both drawn, each names the link.
            return other === undefined || other === index || (other < index && numbers[other] === number) ? [] : [[index, other]];
        }));
    const labels = [...data.labels].flatMap(([number, label]): [number, string][] => {
        const index = indexOf.get(number);
        return index === undefined ? [] : [[index, label]];
    });
    const common = {
        kind, numbers, indexOf, sessionOf, labels, near, count: data.map.places, apart: new Map<number, number>(),
        unplaced: data.places.length - shown.length,
    };
    if (kind === "metric") return { ...common, links, ...metric(data, shown, near, sessionNumbers) };
    const points = kind === "appearance" ? looks(data, numbers) : places(asDriven(data, shape)(data.map.places), numbers);
    const spaces = new Map(data.graph?.nodes.map(({ place_number, space }) => [place_number, space]));
    const byGraph = data.graph?.links.flatMap(({ from_place_number, to_place_number }): [number, number][] => {
        const [from, to] = [indexOf.get(from_place_number), indexOf.get(to_place_number)];
        return from === undefined || to === undefined ? [] : [[from, to]];
    });
    return {
        ...common,
        corrected: points,
        odometry: points,
        parts: 1,
        links: byGraph ?? links,
        closures: closuresBetween(data, near, points),
        tracks: [],
        spaceOf: Uint32Array.from(numbers, (number) => spaces.get(number) ?? 0),
    };
}

/** A map that closed loops is a ring, unless somebody wants to see it otherwise. */
export function asDriven({ closures }: Pick<MapData, "closures">, shape: Shape | null): (count: number) => Points {
    return (shape ?? (closures.length ? "ring" : "strip")) === "ring" ? ring : strip;
}

/** The points of some places, of those of all. */
function places(all: Points, numbers: number[]): Points {
    const of = (axis: Float64Array) => Float64Array.from(numbers, (number) => axis[number] ?? 0);
    return { x: of(all.x), y: of(all.y) };
}

function looks({ graph }: MapData, numbers: number[]): Points {
    const points = empty(numbers.length);
    if (!graph) return points;
    const laid = byLooks(graph);
    const node = new Map(graph.nodes.map(({ place_number }, index) => [place_number, index]));
    numbers.forEach((number, index) => {
        const from = node.get(number);
        points.x[index] = from === undefined ? 0 : laid.x[from]!;
        points.y[index] = from === undefined ? 0 : laid.y[from]!;
    });
    return points;
}

/** How sure a closure is: by all evidence where geometry was asked, else by words. */
export function sure({ probability, posterior }: LoopClosure): number {
    return probability ?? posterior;
}

/** Closures from the place where the robot was a frame before. */
function closuresBetween(data: MapData, near: Near, { x, y }: Points): Closure[] {
    const visits = visitsOf(data);
    return data.closures.flatMap((closure): Closure[] => {
        const to = near(closure.place_number);
        if (to === undefined || !closure.frame || closure.correction) return [];
        const before = lastBefore(visits.get(closure.frame.session) ?? [], closure.frame.sequence);
        const from = before === null ? to : (near(before) ?? to);
        const point: [number, number] = [x[from]!, y[from]!];
        return [{ probability: sure(closure), to, corrected: point, odometry: point }];
    });
}

type Visit = [sequence: Sequence, place: number];

/** Where each session was, by sequence number. */
export function visitsOf({ places }: Pick<MapData, "places">): Map<string, Visit[]> {
    const visits = new Map<string, Visit[]>();
    for (const place of places) {
        const number = Number(short(place.name));
        for (const { session, sequence } of place.frames) {
            const there = visits.get(session);
            if (there) there.push([sequence, number]);
            else visits.set(session, [[sequence, number]]);
        }
    }
    for (const there of visits.values()) there.sort(([a], [b]) => compare(a, b));
    return visits;
}

function lastBefore(visits: Visit[], sequence: Sequence): number | null {
    let found: number | null = null;
    for (const [at, place] of visits) {
        if (compare(at, sequence) >= 0) break;
        found = place;
    }
    return found;
}

type Numbered = Map<string, number>;
type Near = Scene["near"];

function metric(data: MapData, shown: MapData["places"], near: Near, sessions: Numbered) {
    const apart = sideBySide(shown);
    const corrected = empty(shown.length);
    shown.forEach((place, index) => {
        const at = pose(place.pose?.pose)!;
        corrected.x[index] = at.x + (apart.get(place.pose!.part) ?? 0);
        corrected.y[index] = at.y;
    });
    const wheels = new Map([...data.drives].map(([session, drive]) => [session, anchored(drive)]));
    // Of a long way the row before will do.
    const row = (rows: Stamped[] | undefined, session: string, stamp_s: number) =>
        (data.drives.get(session)?.every ?? 1) > 1 ? (rows?.[until(rows, stamp_s)] ?? null) : rowOf(rows ?? [], stamp_s);
    const parts = partsOf(shown);
    const odometry: Points = { x: corrected.x.slice(), y: corrected.y.slice() };
    shown.forEach((place, index) => {
        const frame = place.frames[0];
        const found = frame && row(wheels.get(frame.session), frame.session, frame.stamp_ns / NS);
        if (!found) return;
        odometry.x[index] = found.x + (apart.get(place.pose!.part) ?? 0);
        odometry.y[index] = found.y;
    });
    const shift = (session: string, stamp_s: number) => apart.get(partAt(parts.get(session) ?? [], stamp_s)) ?? 0;
    const tracks = [...data.drives].map(([session, drive]): Track => ({
        session: sessions.get(session) ?? 0,
        corrected: line(drive.corrected, (row) => shift(session, row.stamp_s)),
        odometry: line(wheels.get(session) ?? [], (row) => shift(session, row.stamp_s)),
    }));
    const closures = data.closures.flatMap((closure): Closure[] => {
        const to = near(closure.place_number);
        const frame = closure.frame;
        if (to === undefined || !frame || closure.correction) return [];
        const stamp_s = frame.stamp_ns / NS;
        const aside = shift(frame.session, stamp_s);
        const at = row(data.drives.get(frame.session)?.corrected, frame.session, stamp_s);
        const by = row(wheels.get(frame.session), frame.session, stamp_s) ?? at;
        const here: [number, number] = [corrected.x[to]!, corrected.y[to]!];
        return [{
            probability: sure(closure), to,
            corrected: at ? [at.x + aside, at.y] : here,
            odometry: by ? [by.x + aside, by.y] : here,
        }];
    });
    const spaceOf = Uint32Array.from(shown, (place) => place.pose!.part);
    return { corrected, odometry, apart, parts: apart.size, closures, tracks, spaceOf };
}

/** How far each part of the map is moved to the right, so that none lies on another. */
function sideBySide(places: MapData["places"]): Map<number, number> {
    const extents = new Map<number, [number, number]>();
    for (const place of places) {
        const { x } = pose(place.pose?.pose)!;
        const [low, high] = extents.get(place.pose!.part) ?? [x, x];
        extents.set(place.pose!.part, [Math.min(low, x), Math.max(high, x)]);
    }
    const apart = new Map<number, number>();
    let end: number | null = null;
    for (const [part, [low, high]] of [...extents].sort(([a], [b]) => a - b)) {
        const gap = PART_GAP * (high - low) + 1;
        const moved: number = end === null ? 0 : end + gap - low;
        apart.set(part, moved);
        end = high + moved;
    }
    return apart;
}

/** The wheels' way, turned and moved so that it begins where the map puts its first frame. */
function anchored({ corrected, odometry }: Drive): Stamped[] {
    const first = corrected[0];
    const same = first && rowOf(odometry, first.stamp_s);
    if (!same) return [];
    const move = compose(first, inverse(same));
    return odometry.map((row) => ({ ...compose(move, row), stamp_s: row.stamp_s }));
}

type PartRow = Stamped & { part: number };

/** In which part of the map each session was, from the places it made or came back to. */
function partsOf(places: MapData["places"]): Map<string, PartRow[]> {
    const found = new Map<string, PartRow[]>();
    for (const place of places) {
        for (const { session, stamp_ns } of place.frames) {
            const row = { stamp_s: stamp_ns / NS, x: 0, y: 0, heading: 0, part: place.pose!.part };
            const rows = found.get(session);
            if (rows) rows.push(row);
            else found.set(session, [row]);
        }
    }
    for (const rows of found.values()) rows.sort((a, b) => a.stamp_s - b.stamp_s);
    return found;
}

function partAt(rows: PartRow[], stamp_s: number): number {
    return (rows[until(rows, stamp_s)] ?? rows[0])?.part ?? 0;
}

function line(rows: Stamped[], aside: (row: Stamped) => number): Points {
    return { x: Float64Array.from(rows, (row) => row.x + aside(row)), y: Float64Array.from(rows, (row) => row.y) };
}

/** Points between the wheels' (0) and the map's (1). */
export function between(odometry: Points, corrected: Points, share: number): Points {
    if (share >= 1 || odometry.x.length !== corrected.x.length) return corrected;
    const mix = (from: Float64Array, to: Float64Array) => from.map((value, at) => value + (to[at]! - value) * share);
    return { x: mix(odometry.x, corrected.x), y: mix(odometry.y, corrected.y) };
}

export interface Box {
    x: [number, number];
    y: [number, number];
}

/** All that is drawn of a map, ways too: a robot may be far from the last place that it made. */
export function boxOf({ corrected, odometry, tracks }: Scene, besides: readonly [number, number][] = []): Box {
    let [left, right, low, high] = [Infinity, -Infinity, Infinity, -Infinity];
    const take = (x: number, y: number) => {
        left = Math.min(left, x);
        right = Math.max(right, x);
        low = Math.min(low, y);
        high = Math.max(high, y);
    };
    for (const { x, y } of [corrected, odometry, ...tracks.flatMap((track) => [track.corrected, track.odometry])]) {
        for (let at = 0; at < x.length; at++) take(x[at]!, y[at]!);
    }
    for (const [x, y] of besides) take(x, y);
    return left <= right ? { x: [left, right], y: [low, high] } : { x: [-1, 1], y: [-1, 1] };
}
