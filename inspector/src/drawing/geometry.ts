// Poses on the floor: x and y in metres, heading in radians.
import type { Schemas } from "../rest";

export interface Pose {
    x: number;
    y: number;
    heading: number;
}

type GivenPose = Schemas["Pose"] | null | undefined;

export function pose(given: GivenPose): Pose | null {
    const [position, turn] = [given?.position_m, given?.orientation];
    if (!position || !turn) return null;
    return { x: position.x, y: position.y, heading: heading(turn.x, turn.y, turn.z, turn.w) };
}

function heading(x: number, y: number, z: number, w: number): number {
    return Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
}

/** `inner`, seen from where `outer` is. */
export function compose(outer: Pose, inner: Pose): Pose {
    const [cos, sin] = [Math.cos(outer.heading), Math.sin(outer.heading)];
    return {
        x: outer.x + cos * inner.x - sin * inner.y,
        y: outer.y + sin * inner.x + cos * inner.y,
        heading: outer.heading + inner.heading,
    };
}

export function inverse({ x, y, heading }: Pose): Pose {
    const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
    return { x: -cos * x - sin * y, y: sin * x - cos * y, heading: -heading };
}

export interface Stamped extends Pose {
    stamp_s: number;
}

/** The lines of a trajectory in TUM's format. */
export function trajectory(tum: string): Stamped[] {
    const found: Stamped[] = [];
    for (const line of tum.split("\n")) {
        if (!line || line.startsWith("#")) continue;
        const [stamp_s, x, y, , qx, qy, qz, qw] = line.split(" ").map(Number);
        if (stamp_s === undefined || qw === undefined || x === undefined || y === undefined) continue;
        found.push({ stamp_s, x, y, heading: heading(qx!, qy!, qz!, qw) });
    }
    return found;
}

/** Stamps are doubles here, which tell a quarter of a microsecond apart. */
const SAME_S = 1e-5;

/** The index of the last row that is no later than a stamp, or -1; rows are in the order of their stamps. */
export function until(rows: readonly Stamped[], stamp_s: number): number {
    let [low, high] = [0, rows.length];
    while (low < high) {
        const middle = (low + high) >> 1;
        if (rows[middle]!.stamp_s <= stamp_s + SAME_S) low = middle + 1;
        else high = middle;
    }
    return low - 1;
}

/** The row of a stamp, if there is one. */
export function rowOf(rows: readonly Stamped[], stamp_s: number): Stamped | null {
    const row = rows[until(rows, stamp_s)];
    return row && Math.abs(row.stamp_s - stamp_s) <= 2 * SAME_S ? row : null;
}
