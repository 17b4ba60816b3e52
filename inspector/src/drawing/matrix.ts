// The match matrix: its tiles as they come, and how they are painted. Rows lie at y = -row, columns at x = column.
import { at, blob, type Schemas } from "../rest";
import { viridis, type Ink } from "./colours";
import { toScreen, type Size, type View } from "./paint";

export type MatchMatrix = Schemas["MatchMatrix"];

/** Positions along the two sides: a cell of the finest level. */
export type Cell = [row: number, column: number];

export interface TileAt {
    level: number;
    row: number;
    column: number;
}

interface Tile {
    shades: Uint8Array;
    /** Painted, by how many cells a side became one. */
    painted: Map<number, HTMLCanvasElement>;
}

/** Tiles that are asked for at a time: the server computes one after the other. */
const MOST_ASKED = 2;
const MOST_KEPT = 400;
const REFUSED_MS = 10_000;

const key = ({ level, row, column }: TileAt) => `${level}/${row}/${column}`;

/** The tiles of a matrix; those that were looked at longest ago make room. */
export class Tiles {
    private readonly known = new Map<string, Tile>();
    private readonly asked = new Map<string, AbortController>();
    private wanted: TileAt[] = [];
    /** When a tile was refused: it is asked for again, and not at once. */
    private readonly refused = new Map<string, number>();
    error: Error | null = null;

    constructor(private readonly matrix: MatchMatrix, private readonly changed: () => void) {}

    /** Asks for what is seen, the first first; what is not seen any more is asked for no more. */
    want(tiles: TileAt[]) {
        this.wanted = tiles;
        const keys = new Set(tiles.map(key));
        for (const [name, gone] of this.asked) {
            if (!keys.has(name)) gone.abort();
        }
        this.go();
    }

    /** Whether all that is seen is there. */
    get complete(): boolean {
        return this.wanted.every((tile) => this.known.has(key(tile)));
    }

    get(tile: TileAt): Tile | null {
        return this.known.get(key(tile)) ?? null;
    }

    /** A tile now or when it comes, also of what is not seen. */
    async of(tile: TileAt, signal?: AbortSignal): Promise<Tile> {
        const known = this.get(tile);
        if (known) return known;
        const { map, against } = this.matrix;
        const other = against === map ? "" : `?against=${encodeURIComponent(against.slice(5))}`;
        const bytes = await blob(`${at(map)}/matrix/tiles/${key(tile)}${other}`, signal);
        const read = { shades: await shadesOf(bytes), painted: new Map() };
        this.known.set(key(tile), read);
        for (const oldest of this.known.keys()) {
            if (this.known.size <= MOST_KEPT) break;
            this.known.delete(oldest);
        }
        return read;
    }

    forget() {
        this.want([]);
        this.known.clear();
    }

    private go() {
        for (const tile of this.wanted) {
            const name = key(tile);
            if (this.asked.size >= MOST_ASKED) return;
            if (this.known.has(name) || this.asked.has(name) || performance.now() - (this.refused.get(name) ?? -Infinity) < REFUSED_MS) continue;
            const gone = new AbortController();
            this.asked.set(name, gone);
            this.of(tile, gone.signal).then(() => (this.error = null), (error: Error) => {
                if (gone.signal.aborted) return;
                this.error = error;
                this.refused.set(name, performance.now());
                setTimeout(() => this.go(), REFUSED_MS + 100);
            }).finally(() => {
                this.asked.delete(name);
                this.changed();
                this.go();
            });
        }
    }
}

async function shadesOf(png: Blob): Promise<Uint8Array> {
    const image = await createImageBitmap(png, { colorSpaceConversion: "none" });
    const canvas = new OffscreenCanvas(image.width, image.height);
    const context = canvas.getContext("2d", { willReadFrequently: true })!;
    context.drawImage(image, 0, 0);
    const { data } = context.getImageData(0, 0, image.width, image.height);
    return Uint8Array.from({ length: data.length / 4 }, (_, at) => data[4 * at]!);
}

const RAMP = Uint32Array.from({ length: 256 }, (_, shade) => {
    const [red, green, blue] = viridis(shade / 255);
    return new Uint32Array(Uint8Array.from([red, green, blue, 255]).buffer)[0]!;
});

/** A tile as a picture of which `shrink` cells a side are one pixel: the largest of them, so that none is lost. */
function painted(tile: Tile, side: number, shrink: number): HTMLCanvasElement {
    const known = tile.painted.get(shrink);
    if (known) return known;
    const size = side / shrink;
    const largest = new Uint8Array(size * size);
    tile.shades.forEach((shade, at) => {
        const to = Math.floor(Math.floor(at / side) / shrink) * size + Math.floor((at % side) / shrink);
        if (shade > largest[to]!) largest[to] = shade;
    });
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = size;
    const colours = Uint32Array.from(largest, (shade) => RAMP[shade]!);
    canvas.getContext("2d")!.putImageData(new ImageData(new Uint8ClampedArray(colours.buffer), size, size), 0, 0);
    tile.painted.set(shrink, canvas);
    return canvas;
}

export function sides({ rows, columns }: MatchMatrix): [rows: number, columns: number] {
    return [rows?.place_numbers.length ?? 0, columns?.place_numbers.length ?? 0];
}

const MARGIN_PX = 28;

export function fitMatrix(matrix: MatchMatrix, { width, height }: Size): View {
    const [rows, columns] = sides(matrix);
    const room = (pixels: number) => Math.max(pixels - 2 * MARGIN_PX, 10);
    const scale = Math.min(room(width) / Math.max(columns, 1), room(height) / Math.max(rows, 1), 40);
    return { x: columns / 2, y: -rows / 2, scale };
}

/** The level whose cells are a pixel or more, and how many of the coarsest would be one where even that has too many. */
export function levelAt({ levels, tile_cells }: MatchMatrix, scale: number): { level: number; shrink: number } {
    const wanted = Math.max(Math.ceil(Math.log2(1 / scale) - 1e-9), 0);
    const level = Math.min(wanted, levels - 1);
    return { level, shrink: Math.min(2 ** (wanted - level), tile_cells) };
}

/** The tiles of a level that are seen, those in the middle first. */
export function seen(matrix: MatchMatrix, level: number, view: View, size: Size): TileAt[] {
    const side = matrix.tile_cells * 2 ** level;
    const [rows, columns] = sides(matrix);
    const [half, tall] = [size.width / 2 / view.scale, size.height / 2 / view.scale];
    const range = (from: number, to: number, all: number) => {
        const [first, last] = [Math.max(Math.floor(from / side), 0), Math.min(Math.floor(to / side), Math.ceil(all / side) - 1)];
        return Array.from({ length: Math.max(last - first + 1, 0) }, (_, at) => first + at);
    };
    const found = range(-view.y - tall, -view.y + tall, rows).flatMap((row) =>
        range(view.x - half, view.x + half, columns).map((column): TileAt => ({ level, row, column })));
    const far = ({ row, column }: TileAt) => Math.hypot((column + 0.5) * side - view.x, (row + 0.5) * side + view.y);
    return found.sort((a, b) => far(a) - far(b));
}

export function paintMatrix(
    context: CanvasRenderingContext2D, matrix: MatchMatrix, tiles: Tiles, view: View, size: Size, cell: Cell | null, ink: Ink,
) {
    context.clearRect(0, 0, size.width, size.height);
    const screen = toScreen(view, size);
    const [rows, columns] = sides(matrix);
    const y = (row: number) => screen.y(-row);
    context.save();
    context.beginPath();
    context.rect(screen.x(0), y(0), columns * view.scale, rows * view.scale);
    context.fillStyle = ink.line;
    context.fill();
    context.clip();
    const { level, shrink } = levelAt(matrix, view.scale);
    // Coarser tiles stand in for those that are still to come.
    for (let coarse = matrix.levels - 1; coarse >= level; coarse--) {
        for (const at of seen(matrix, coarse, view, size)) {
            const tile = tiles.get(at);
            if (!tile) continue;
            const side = matrix.tile_cells * 2 ** coarse;
            context.imageSmoothingEnabled = view.scale * 2 ** coarse * shrink < 1;
            const length = side * view.scale;
            context.drawImage(painted(tile, matrix.tile_cells, shrink), screen.x(at.column * side), y(at.row * side), length, length);
        }
    }
    context.restore();
    borders(context, matrix, view, size, ink);
    marks(context, matrix, view, size);
    if (cell) {
        const cells = 2 ** level;
        const [row, column] = cell.map((at) => Math.floor(at / cells) * cells) as Cell;
        const side = Math.max(cells * view.scale, 7);
        for (const [colour, width] of [["#000", 4], ["#fff", 2]] as const) {
            context.strokeStyle = colour;
            context.lineWidth = width;
            context.strokeRect(screen.x(column + cells / 2) - side / 2, y(row + cells / 2) - side / 2, side, side);
        }
    }
}

/** Lines where a session ends and the next begins, with the names of those that have room. */
function borders(context: CanvasRenderingContext2D, matrix: MatchMatrix, view: View, size: Size, ink: Ink) {
    const screen = toScreen(view, size);
    const [rows, columns] = sides(matrix);
    context.strokeStyle = "#ffffffb0";
    context.lineWidth = 1;
    context.beginPath();
    for (const { first } of matrix.rows?.sessions.slice(1) ?? []) {
        const at = Math.round(screen.y(-first)) + 0.5;
        context.moveTo(screen.x(0), at);
        context.lineTo(screen.x(columns), at);
    }
    for (const { first } of matrix.columns?.sessions.slice(1) ?? []) {
        const at = Math.round(screen.x(first)) + 0.5;
        context.moveTo(at, screen.y(0));
        context.lineTo(at, screen.y(-rows));
    }
    context.stroke();
    context.fillStyle = ink.text;
    context.font = "11px system-ui, sans-serif";
    context.textBaseline = "bottom";
    context.textAlign = "left";
    const above = Math.max(screen.y(0), 14);
    for (const { session, first, places } of matrix.columns?.sessions ?? []) {
        const [left, right] = [Math.max(screen.x(first), 2), Math.min(screen.x(first + places), size.width - 50)];
        const name = session.slice(session.lastIndexOf("/") + 1);
        if (context.measureText(name).width < right - left) context.fillText(name, left + 1, above - 2);
    }
}

/** What the map has joined, on both sides of the diagonal: closures as rings, links as dots, never smaller than can be seen. */
function marks(context: CanvasRenderingContext2D, { marks }: MatchMatrix, view: View, size: Size) {
    const screen = toScreen(view, size);
    const radius = Math.min(Math.max(view.scale * 0.3, 2), 7);
    for (const kind of ["link", "loop_closure"] as const) {
        const rings = kind === "loop_closure";
        context.beginPath();
        for (const mark of marks) {
            if (mark.kind !== kind) continue;
            for (const [row, column] of [[mark.row, mark.column], [mark.column, mark.row]] as const) {
                const [px, py] = [screen.x(column + 0.5), screen.y(-row - 0.5)];
                if (px < -9 || py < -9 || px > size.width + 9 || py > size.height + 9) continue;
                const reach = rings ? radius + 1.5 : radius * 0.6;
                context.moveTo(px + reach, py);
                context.arc(px, py, reach, 0, 2 * Math.PI);
            }
        }
        if (rings) {
            context.strokeStyle = "#000";
            context.lineWidth = 3;
            context.stroke();
            context.strokeStyle = "#ff9d45";
            context.lineWidth = 1.6;
            context.stroke();
        } else {
            context.fillStyle = "#fff";
            context.fill();
        }
    }
}

/** The cell under a point of the screen; none beside the matrix. */
export function cellAt(matrix: MatchMatrix, view: View, size: Size, [px, py]: [number, number]): Cell | null {
    const column = Math.floor((px - size.width / 2) / view.scale + view.x);
    const row = Math.floor(-((size.height / 2 - py) / view.scale + view.y));
    const [rows, columns] = sides(matrix);
    return row >= 0 && column >= 0 && row < rows && column < columns ? [row, column] : null;
}

/** The shade of the cell of a level that holds a pair; none while its tile is not there. */
export function shadeOf(matrix: MatchMatrix, tiles: Tiles, level: number, [row, column]: Cell): number | null {
    const side = matrix.tile_cells;
    const [down, right] = [row >> level, column >> level];
    const tile = tiles.get({ level, row: Math.floor(down / side), column: Math.floor(right / side) });
    return tile ? tile.shades[(down % side) * side + (right % side)]! : null;
}

/** The brightest pair of places among those of a coarse cell. */
export async function brightest(matrix: MatchMatrix, tiles: Tiles, level: number, [row, column]: Cell): Promise<Cell> {
    if (level === 0) return [row, column];
    const [side, cells] = [matrix.tile_cells, 2 ** level];
    const [top, left] = [Math.floor(row / cells) * cells, Math.floor(column / cells) * cells];
    const tile = await tiles.of({ level: 0, row: Math.floor(top / side), column: Math.floor(left / side) });
    const [rows, columns] = sides(matrix);
    let [best, most]: [Cell, number] = [[row, column], -1];
    for (let down = top; down < Math.min(top + cells, rows); down++) {
        for (let right = left; right < Math.min(left + cells, columns); right++) {
            const shade = tile.shades[(down % side) * side + (right % side)]!;
            // Of those that are all alike the one that joins what is furthest apart: the diagonal says nothing new.
            if (shade > most || (shade === most && Math.abs(down - right) > Math.abs(best[0] - best[1]))) [best, most] = [[down, right], shade];
        }
    }
    return best;
}
