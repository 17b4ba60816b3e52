// Draws a scene on a canvas. One path a colour: ten thousand places take a few milliseconds.
import type { Colour } from "../link";
import { named, step, STEPS, type Ink } from "./colours";
import type { Points } from "./layout";
import { paintRobots, type Spot, type Standing } from "./robots";
import { between, boxOf, type Scene } from "./scene";

/** What of the world is seen: its middle, and pixels a unit. */
export interface View {
    x: number;
    y: number;
    scale: number;
}

export interface Size {
    width: number;
    height: number;
}

export interface Look {
    colour: Colour;
    /** 0 by odometry, 1 corrected. */
    corrected: number;
    place: number | null;
    /** Whether loop closures are drawn. */
    closures: boolean;
    robots: Standing[];
    /** Routes that robots follow, point by point to the goal. */
    routes: [number, number][][];
    /** Links by what is left over, from 0 to 1, the worst last; without it, all alike. */
    residuals: [from: number, to: number, amount: number][] | null;
}

export const MARGIN_PX = 36;
const SMALL_MARGIN_PX = 14;
const EDGE_PX = 24;

/** A view of all of a scene, and of some spots besides. */
export function fit(scene: Scene, { width, height }: Size, margin = MARGIN_PX, besides: readonly Spot[] = []): View {
    const { x, y } = boxOf(scene, besides);
    const room = (pixels: number) => Math.max(pixels - 2 * margin, 10);
    const scale = Math.min(room(width) / Math.max(x[1] - x[0], 1e-3), room(height) / Math.max(y[1] - y[0], 1e-3), 400);
    return { x: (x[0] + x[1]) / 2, y: (y[0] + y[1]) / 2, scale };
}

export function toScreen({ x, y, scale }: View, { width, height }: Size) {
    return {
        x: (world: number) => (world - x) * scale + width / 2,
        y: (world: number) => (y - world) * scale + height / 2,
    };
}

/** The place that is drawn nearest to a point of the screen, within `reach` pixels. */
export function placeAt(points: Points, view: View, size: Size, [px, py]: [number, number], reach: number) {
    const screen = toScreen(view, size);
    let best: number | null = null;
    let nearest = reach * reach;
    for (let at = 0; at < points.x.length; at++) {
        const [dx, dy] = [screen.x(points.x[at]!) - px, screen.y(points.y[at]!) - py];
        const apart = dx * dx + dy * dy;
        if (apart <= nearest) [best, nearest] = [at, apart];
    }
    return best;
}

/** Whether a spot is seen, and not at the very edge. */
export function isSeen([x, y]: Spot, view: View, size: Size): boolean {
    const screen = toScreen(view, size);
    const within = (at: number, most: number) => at >= EDGE_PX && at <= most - EDGE_PX;
    return within(screen.x(x), size.width) && within(screen.y(y), size.height);
}

/** Draws all, and tells where on the screen the robots are. */
export function paint(context: CanvasRenderingContext2D, scene: Scene, look: Look, view: View, size: Size, ink: Ink): Spot[] {
    context.clearRect(0, 0, size.width, size.height);
    const screen = toScreen(view, size);
    if (scene.kind === "metric") axes(context, view, size, ink);
    const points = between(scene.odometry, scene.corrected, look.corrected);
    const pen = { context, screen, ink, scale: view.scale };
    if (look.corrected < 1) {
        for (const track of scene.tracks) way(pen, track.odometry, ink.odometry, 1);
    }
    pairs(pen, points, scene.links);
    if (look.closures) closures(pen, scene, points, look.corrected);
    // Above closures: of a map with many, the colours of sessions would be lost.
    for (const track of scene.tracks) {
        const line = between(track.odometry, track.corrected, look.corrected);
        way(pen, line, look.colour === "session" && !look.residuals ? named(track.session) : ink.link, 1.5);
    }
    // Where colours are the links', places have none.
    places(pen, scene, points, look.residuals ? null : look.colour, size);
    if (look.residuals) leftOver(pen, points, look.residuals);
    routes(pen, look.routes);
    labels(pen, scene, points, size);
    if (look.place !== null) marked(pen, points, look.place);
    if (scene.kind === "metric") scaleBar(context, view, size, ink);
    return paintRobots(context, look.robots, screen, size.width, ink);
}

/** The picture of a map in the list: its ways, links and places alone. */
export function paintSmall(context: CanvasRenderingContext2D, scene: Scene, size: Size, ink: Ink) {
    const view = fit(scene, size, SMALL_MARGIN_PX);
    const pen = { context, screen: toScreen(view, size), ink, scale: view.scale };
    pairs(pen, scene.corrected, scene.links);
    for (const track of scene.tracks) way(pen, track.corrected, ink.link, 1);
    places(pen, scene, scene.corrected, scene.kind === "appearance" ? "space" : "time", size);
}

interface Pen {
    context: CanvasRenderingContext2D;
    screen: ReturnType<typeof toScreen>;
    ink: Ink;
    scale: number;
}

function way({ context, screen }: Pen, { x, y }: Points, colour: string, width: number) {
    context.beginPath();
    for (let at = 0; at < x.length; at++) context.lineTo(screen.x(x[at]!), screen.y(y[at]!));
    context.strokeStyle = colour;
    context.lineWidth = width;
    context.stroke();
}

function pairs({ context, screen, ink }: Pen, { x, y }: Points, links: [number, number][]) {
    context.beginPath();
    for (const [from, to] of links) {
        context.moveTo(screen.x(x[from]!), screen.y(y[from]!));
        context.lineTo(screen.x(x[to]!), screen.y(y[to]!));
    }
    context.strokeStyle = ink.link;
    context.lineWidth = 1;
    context.stroke();
}

/** The worse, the further along the ramp, and the thicker: colour alone need not say it. */
function leftOver({ context, screen, ink }: Pen, { x, y }: Points, residuals: NonNullable<Look["residuals"]>) {
    let [at, level] = [0, 0];
    for (; level < STEPS; level++) {
        context.beginPath();
        for (; at < residuals.length && step(residuals[at]![2]) <= level; at++) {
            const [from, to] = residuals[at]!;
            context.moveTo(screen.x(x[from]!), screen.y(y[from]!));
            context.lineTo(screen.x(x[to]!), screen.y(y[to]!));
        }
        context.strokeStyle = ink.worse[level]!;
        context.lineWidth = 2.5 + (5 * level) / STEPS;
        context.stroke();
    }
}

/** The way that a robot is to go, and a ring where it ends. */
function routes({ context, screen, ink }: Pen, ways: Look["routes"]) {
    for (const way of ways) {
        const end = way.at(-1);
        if (!end) continue;
        for (const [colour, width] of [[ink.back, 7], [ink.heat, 3.5]] as const) {
            context.beginPath();
            for (const [x, y] of way) context.lineTo(screen.x(x), screen.y(y));
            context.moveTo(screen.x(end[0]) + 8, screen.y(end[1]));
            context.arc(screen.x(end[0]), screen.y(end[1]), 8, 0, 2 * Math.PI);
            context.setLineDash(colour === ink.heat ? [9, 5] : []);
            context.strokeStyle = colour;
            context.lineWidth = width;
            context.stroke();
        }
    }
    context.setLineDash([]);
}

/** Closures by probability: dashed where it is low, so that colour alone need not say it. */
function closures({ context, screen, ink, scale }: Pen, scene: Scene, { x, y }: Points, share: number) {
    const ring = dot(scale) + 2;
    const levels = [
        { from: 0, width: 1, dash: [3, 3], alpha: 0.75 },
        { from: 0.9, width: 1.6, dash: [], alpha: 0.8 },
        { from: 0.97, width: 2.4, dash: [], alpha: 0.95 },
    ];
    levels.forEach(({ from, width, dash, alpha }, level) => {
        const below = levels[level + 1]?.from ?? Infinity;
        context.beginPath();
        for (const { probability, to, corrected, odometry } of scene.closures) {
            if (probability < from || probability >= below) continue;
            const mixed = (axis: 0 | 1) => odometry[axis] + (corrected[axis] - odometry[axis]) * share;
            context.moveTo(screen.x(mixed(0)), screen.y(mixed(1)));
            context.lineTo(screen.x(x[to]!), screen.y(y[to]!));
        }
        context.globalAlpha = alpha;
        context.setLineDash(dash);
        context.strokeStyle = ink.closure;
        context.lineWidth = width;
        context.stroke();
    });
    context.setLineDash([]);
    // Around the place's dot, thin, and once however often it was known again: its colour shows.
    context.beginPath();
    for (const to of new Set(scene.closures.map(({ to }) => to))) {
        const [px, py] = [screen.x(x[to]!), screen.y(y[to]!)];
        context.moveTo(px + ring, py);
        context.arc(px, py, ring, 0, 2 * Math.PI);
    }
    context.lineWidth = 1;
    context.stroke();
    context.globalAlpha = 1;
}

/** The radius of a place, in pixels. */
function dot(scale: number): number {
    return Math.min(Math.max(scale * 0.14, 1.6), 5.5);
}

/** How much larger each map is drawn that lies below another. */
const BELOW_PX = 2.5;

function places({ context, screen, ink, scale }: Pen, scene: Scene, { x, y }: Points, colour: Colour | null, size: Size) {
    const buckets = new Map<string, number[]>();
    for (let at = 0; at < x.length; at++) {
        const key = colour ? colourOf(scene, at, colour, ink) : ink.link;
        const bucket = buckets.get(key);
        if (bucket) bucket.push(at);
        else buckets.set(key, [at]);
    }
    const last = buckets.size - 1;
    for (const [at, [fill, bucket]] of [...buckets].entries()) {
        const radius = dot(scale) + (scene.layered ? (last - at) * BELOW_PX : 0);
        context.beginPath();
        for (const at of bucket) {
            const [px, py] = [screen.x(x[at]!), screen.y(y[at]!)];
            if (px < -9 || py < -9 || px > size.width + 9 || py > size.height + 9) continue;
            if (radius < 2.5) {
                context.rect(px - radius, py - radius, 2 * radius, 2 * radius);
            } else {
                context.moveTo(px + radius, py);
                context.arc(px, py, radius, 0, 2 * Math.PI);
            }
        }
        context.fillStyle = fill;
        context.fill();
    }
}

function colourOf(scene: Scene, at: number, colour: Colour, { ramp }: Ink): string {
    if (colour === "time") return ramp[step((scene.count > scene.numbers.length ? scene.numbers[at]! : at) / Math.max(scene.count - 1, 1))]!;
    return named((colour === "session" ? scene.sessionOf : scene.spaceOf)[at]!);
}

const MOST_LABELS = 300;
const LABEL_PX = 9;
const LABEL_EDGE_PX = 4;

function labels({ context, screen, ink }: Pen, scene: Scene, { x, y }: Points, size: Size) {
    context.font = "600 12px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "left";
    context.lineWidth = 4;
    context.lineJoin = "round";
    for (const [at, label] of scene.labels.slice(0, MOST_LABELS)) {
        const [spot, py] = [screen.x(x[at]!), screen.y(y[at]!)];
        if (spot < 0 || py < 0 || spot > size.width || py > size.height) continue;
        const shown = label.length > 40 ? `${label.slice(0, 39)}…` : label;
        const px = besideDot(spot, context.measureText(shown).width, size.width);
        context.strokeStyle = ink.back;
        context.strokeText(shown, px, py);
        context.fillStyle = ink.text;
        context.fillText(shown, px, py);
    }
}

/** Where a text begins that is beside a dot: right of it, else left of it, else wherever it has room. */
function besideDot(spot: number, wide: number, width: number): number {
    if (spot + LABEL_PX + wide <= width - LABEL_EDGE_PX) return spot + LABEL_PX;
    if (spot - LABEL_PX - wide >= LABEL_EDGE_PX) return spot - LABEL_PX - wide;
    return Math.max(width - LABEL_EDGE_PX - wide, LABEL_EDGE_PX);
}

function marked({ context, screen, ink }: Pen, { x, y }: Points, at: number) {
    if (x[at] === undefined || y[at] === undefined) return;
    for (const [radius, colour, width] of [[10, ink.back, 6], [10, ink.accent, 3]] as const) {
        context.beginPath();
        context.arc(screen.x(x[at]), screen.y(y[at]), radius, 0, 2 * Math.PI);
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.stroke();
    }
}

/** A round length in metres of about `pixels`. */
export function roundLength(scale: number, pixels: number): number {
    const wanted = pixels / scale;
    const power = 10 ** Math.floor(Math.log10(wanted));
    return power * ([5, 2, 1].find((times) => times * power <= wanted) ?? 1);
}

function axes(context: CanvasRenderingContext2D, view: View, size: Size, ink: Ink) {
    const every = roundLength(view.scale, 120);
    const screen = toScreen(view, size);
    const digits = Math.max(0, -Math.floor(Math.log10(every)));
    context.strokeStyle = ink.line;
    context.fillStyle = ink.faint;
    context.lineWidth = 1;
    context.font = "11px system-ui, sans-serif";
    context.beginPath();
    const [half, tall] = [size.width / 2 / view.scale, size.height / 2 / view.scale];
    const written: [string, number, number, CanvasTextAlign][] = [];
    for (let x = Math.ceil((view.x - half) / every) * every; x <= view.x + half; x += every) {
        const at = Math.round(screen.x(x)) + 0.5;
        context.moveTo(at, 0);
        context.lineTo(at, size.height);
        if (at > 50 && at < size.width - 64) written.push([x.toFixed(digits), at, 12, "center"]);
    }
    for (let y = Math.ceil((view.y - tall) / every) * every; y <= view.y + tall; y += every) {
        const at = Math.round(screen.y(y)) + 0.5;
        context.moveTo(0, at);
        context.lineTo(size.width, at);
        if (at > 24 && at < size.height - 44) written.push([y.toFixed(digits), 5, at, "left"]);
    }
    context.stroke();
    context.textBaseline = "middle";
    context.strokeStyle = ink.back;
    context.lineWidth = 4;
    for (const [text, px, py, align] of written) {
        context.textAlign = align;
        context.strokeText(text, px, py);
        context.fillText(text, px, py);
    }
}

function scaleBar(context: CanvasRenderingContext2D, { scale }: View, { height }: Size, ink: Ink) {
    const metres = roundLength(scale, 140);
    const [left, bottom, length] = [16, height - 16, metres * scale];
    context.beginPath();
    context.moveTo(left, bottom - 6);
    context.lineTo(left, bottom);
    context.lineTo(left + length, bottom);
    context.lineTo(left + length, bottom - 6);
    context.strokeStyle = ink.text;
    context.lineWidth = 2;
    context.stroke();
    context.font = "600 12px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "bottom";
    context.fillStyle = ink.text;
    context.fillText(`${metres} m`, left + 6, bottom - 4);
}
