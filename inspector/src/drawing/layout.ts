// Where places are drawn that have no metres: along a strip, around a ring, or where what they look like pulls them.
import type { AppearanceGraph } from "../rest";

export interface Points {
    x: Float64Array;
    y: Float64Array;
}

/** Places in their order around a ring that is open at the top, one unit apart. */
export function ring(count: number): Points {
    const { x, y } = empty(count);
    const radius = Math.max(count, 3) / (2 * Math.PI);
    const gap = 0.06 * Math.PI;
    for (let place = 0; place < count; place++) {
        const angle = Math.PI / 2 - gap - ((2 * Math.PI - 2 * gap) * place) / Math.max(count - 1, 1);
        x[place] = radius * Math.cos(angle);
        y[place] = radius * Math.sin(angle);
    }
    return { x, y };
}

/** Places in their order along lines that turn back at the end, as one reads ploughed land. */
export function strip(count: number): Points {
    const { x, y } = empty(count);
    const columns = Math.max(Math.ceil(Math.sqrt(count * 4)), 8);
    for (let place = 0; place < count; place++) {
        const row = Math.floor(place / columns);
        const column = place % columns;
        x[place] = row % 2 === 0 ? column : columns - 1 - column;
        y[place] = -row * 3;
    }
    return { x, y };
}

/**
 * Places of an appearance graph, by Fruchterman and Reingold (1991): links pull the more the more two places have in
 * common, all others push within three units. The same graph gives the same picture.
 */
export function byLooks({ nodes, links }: AppearanceGraph, rounds = nodes.length > 3000 ? 60 : 200): Points {
    const at = new Map(nodes.map((node, index) => [node.place_number, index]));
    const points = ring(nodes.length);
    const ends = links.flatMap(({ from_place_number, to_place_number, similarity }) => {
        const [from, to] = [at.get(from_place_number), at.get(to_place_number)];
        return from === undefined || to === undefined ? [] : [[from, to, similarity] as const];
    });
    const force = empty(nodes.length);
    const { x, y } = points;
    for (let round = 0; round < rounds; round++) {
        force.x.fill(0);
        force.y.fill(0);
        push(points, force);
        for (const [from, to, similarity] of ends) {
            const [dx, dy] = [x[to]! - x[from]!, y[to]! - y[from]!];
            const pull = Math.hypot(dx, dy) * (0.2 + similarity);
            force.x[from]! += dx * pull;
            force.y[from]! += dy * pull;
            force.x[to]! -= dx * pull;
            force.y[to]! -= dy * pull;
        }
        const most = 2 * (1 - round / rounds) + 0.02;
        for (let node = 0; node < nodes.length; node++) {
            const size = Math.hypot(force.x[node]!, force.y[node]!) || 1;
            const far = Math.min(size * 0.1, most) / size;
            x[node]! += force.x[node]! * far;
            y[node]! += force.y[node]! * far;
        }
    }
    return points;
}

const REACH = 3;

/** Adds what pushes points apart, from those in the same and the next cells of a grid. */
function push({ x, y }: Points, force: Points) {
    const cells = new Map<string, number[]>();
    const cell = (value: number) => Math.floor(value / REACH);
    for (let node = 0; node < x.length; node++) {
        const key = `${cell(x[node]!)},${cell(y[node]!)}`;
        const there = cells.get(key);
        if (there) there.push(node);
        else cells.set(key, [node]);
    }
    for (let node = 0; node < x.length; node++) {
        for (let column = -1; column <= 1; column++) {
            for (let row = -1; row <= 1; row++) {
                const near = cells.get(`${cell(x[node]!) + column},${cell(y[node]!) + row}`) ?? [];
                for (const other of near.length > 60 ? near.slice(0, 60) : near) {
                    if (other === node) continue;
                    const [dx, dy] = [x[node]! - x[other]!, y[node]! - y[other]! || (node - other) * 1e-3];
                    const apart = Math.max(dx * dx + dy * dy, 0.01);
                    if (apart > REACH * REACH) continue;
                    force.x[node]! += dx / apart;
                    force.y[node]! += dy / apart;
                }
            }
        }
    }
}

export function empty(count: number): Points {
    return { x: new Float64Array(count), y: new Float64Array(count) };
}
