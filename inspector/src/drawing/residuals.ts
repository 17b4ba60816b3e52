// How far each measured way between two places is from where the map put them.
import { compose, inverse, type Pose } from "./geometry";

export interface Residual {
    from: number;
    to: number;
    off_m: number;
    off_rad: number;
}

/** The edges of a g2o file of poses in the plane, the one that is furthest off first. */
export function residuals(g2o: string): Residual[] {
    const vertices = new Map<number, Pose>();
    const found: Residual[] = [];
    const edges: (readonly [number, number, Pose])[] = [];
    for (const line of g2o.split("\n")) {
        const [kind, ...fields] = line.split(" ");
        const [a, b, c, d, e] = fields.map(Number);
        if (kind === "VERTEX_SE2") vertices.set(a!, { x: b!, y: c!, heading: d! });
        if (kind === "EDGE_SE2") edges.push([a!, b!, { x: c!, y: d!, heading: e! }]);
    }
    for (const [from, to, measured] of edges) {
        const [start, end] = [vertices.get(from), vertices.get(to)];
        if (!start || !end) continue;
        const off = compose(inverse(measured), compose(inverse(start), end));
        const off_rad = Math.abs(Math.atan2(Math.sin(off.heading), Math.cos(off.heading)));
        found.push({ from, to, off_m: Math.hypot(off.x, off.y), off_rad });
    }
    return found.sort((a, b) => b.off_m - a.off_m);
}

/** What is below a millimetre at worst is rounding. */
export const LEAST_M = 1e-3;

/** Links between drawn places by what is left over as a share of `most_m`, the worst last. */
export function drawn(found: Residual[], near: (number: number) => number | undefined, most_m: number): [number, number, number][] {
    return found.flatMap(({ from, to, off_m }): [number, number, number][] => {
        const [start, end] = [near(from), near(to)];
        return start === undefined || end === undefined || start === end ? [] : [[start, end, off_m / Math.max(most_m, LEAST_M)]];
    }).reverse();
}
