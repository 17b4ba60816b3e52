// Which places look alike: the match matrix of the map with itself, or with another of its model.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { ink } from "../drawing/colours";
import type { MapData } from "../drawing/data";
import {
    brightest, cellAt, fitMatrix, levelAt, paintMatrix, seen, shadeOf, sides, Tiles, type Cell, type MatchMatrix,
} from "../drawing/matrix";
import type { View } from "../drawing/paint";
import { hash, START, type Go, type Link } from "../link";
import { all, at, get, short, type Place, type WayMap } from "../rest";
import { count, Picture, plural, Refused, Shown, useAsked, useDark, useSize } from "../parts";
import { useHand } from "./hand";
import { Large, pairPath } from "./large";

/** In the link: the map with itself. */
const ITSELF = ".";

interface MatrixProps {
    data: MapData;
    link: Link;
    go: Go;
    /** Shows the frame of a place beside another place. */
    onPair: (place: number, beside: number) => void;
    onPlace: (place: number) => void;
}

export function Matrix(props: MatrixProps) {
    const { data, link, go } = props;
    const open = link.matrix !== null;
    return (
        <section class="panel matrix" aria-label="Match matrix">
            <header>
                <h2>Match matrix</h2><span class="quiet">which places look alike</span>
                {open && <Against data={data} link={link} go={go} />}
                <button type="button" aria-expanded={open} onClick={() => go({ matrix: open ? null : ITSELF, cells: null, cell: null })}>{open ? "Close" : "Compare the places"}</button>
            </header>
            {open && <Opened key={link.matrix} {...props} against={link.matrix!} />}
        </section>
    );
}

/** Other maps of the same model. */
function Against({ data: { map }, link, go }: Pick<MatrixProps, "data" | "link" | "go">) {
    const asked = useAsked((signal) => all<"maps", WayMap>("/v1/maps", "maps", signal), [map.name]);
    const maps = asked.state === "there" ? asked.value : [];
    const others = maps.filter(({ name, model }) => name !== map.name && model === map.model).map(({ name }) => short(name));
    const chosen = link.matrix ?? ITSELF;
    if (chosen !== ITSELF && !others.includes(chosen)) others.push(chosen);
    return (
        <label>Against <select value={chosen} onChange={(event) => go({ matrix: event.currentTarget.value, cells: null, cell: null })}>
            <option value={ITSELF}>itself</option>
            {others.map((name) => <option key={name} value={name}>{name}</option>)}
        </select></label>
    );
}

function Opened({ against, ...props }: MatrixProps & { against: string }) {
    const { map } = props.data;
    const other = against === ITSELF ? "" : `?against=${encodeURIComponent(against)}`;
    const asked = useAsked((signal) => get<MatchMatrix>(`${at(map.name)}/matrix${other}`, signal), [map.name, other, map.places, map.loop_closures, map.links]);
    return (
        <Shown asked={asked} what="the matrix">
            {(matrix) => sides(matrix).includes(0)
                ? <p class="empty">{sides(matrix)[0] === 0 ? "This map" : `The map ${against}`} has no places yet, so there is nothing to compare.</p>
                : <Drawn {...props} matrix={matrix} />}
        </Shown>
    );
}

function Drawn({ matrix, data, link, go, onPair, onPlace }: MatrixProps & { matrix: MatchMatrix }) {
    const [box, size] = useSize<HTMLDivElement>();
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    const shown = useRef<View>({ x: 0, y: 0, scale: 1 });
    const asked = useRef(0);
    const [hovered, setHovered] = useState<Cell | null>(null);
    const [changes, setChanges] = useState(0);
    const [rows, columns] = sides(matrix);
    const itself = matrix.map === matrix.against;
    const picked: Cell | null = link.cell && link.cell[0] < rows && link.cell[1] < columns ? link.cell : null;
    const tiles = useMemo(() => new Tiles(matrix, () => {
        setChanges((changes) => changes + 1);
        redraw();
    }), [matrix]);
    useEffect(() => () => tiles.forget(), [tiles]);
    const view = useMemo(() => link.cells && { x: link.cells[0], y: link.cells[1], scale: link.cells[2] }, [link.cells]);

    const draw = () => {
        asked.current = 0;
        const context = canvas.current?.getContext("2d");
        if (!canvas.current || !context || !size.width) return;
        const sharp = devicePixelRatio || 1;
        canvas.current.width = Math.round(size.width * sharp);
        canvas.current.height = Math.round(size.height * sharp);
        context.setTransform(sharp, 0, 0, sharp, 0, 0);
        tiles.want(seen(matrix, levelAt(matrix, shown.current.scale).level, shown.current, size));
        paintMatrix(context, matrix, tiles, shown.current, size, picked, ink(canvas.current));
        canvas.current.dataset["complete"] = String(tiles.complete);
    };
    const redraw = () => {
        if (!asked.current) asked.current = requestAnimationFrame(() => latest.current());
    };
    const latest = useRef(draw);
    latest.current = draw;
    useEffect(() => {
        if (!size.width) return;
        shown.current = view ?? fitMatrix(matrix, size);
        redraw();
    }, [matrix, view, size.width, size.height, dark, picked?.[0], picked?.[1]]);

    const level = () => levelAt(matrix, shown.current.scale).level;
    const pick = async (cell: Cell) => {
        const [row, column] = await brightest(matrix, tiles, level(), cell);
        go({ cell: [row, column] });
        if (!itself) return;
        const [one, other] = [matrix.rows!.place_numbers[row]!, matrix.columns!.place_numbers[column]!];
        // The later one is shown: the other was there when it came.
        if (one === other) onPlace(one);
        else onPair(Math.max(one, other), Math.min(one, other));
    };
    const step = (event: KeyboardEvent): boolean => {
        if (event.key === "Enter" && picked) {
            void pick(picked);
            return true;
        }
        const far = 2 ** level();
        const by: Record<string, Cell> = { ArrowLeft: [0, -far], ArrowRight: [0, far], ArrowUp: [-far, 0], ArrowDown: [far, 0] };
        const moved = by[event.key];
        if (!moved) return false;
        const [row, column] = picked ?? [Math.floor(rows / 2), Math.floor(columns / 2)];
        const within = (at: number, all: number) => Math.min(Math.max(at, 0), all - 1);
        setHovered(null);
        go({ cell: picked ? [within(row + moved[0], rows), within(column + moved[1], columns)] : [row, column] });
        return true;
    };
    const { hand, zoom, all: whole } = useHand({
        canvas, size, shown, redraw, scales: [1e-4, 80], onKey: step,
        onView: (view) => go({ cells: view && [view.x, view.y, view.scale] }),
        onClick: (spot) => {
            const cell = cellAt(matrix, shown.current, size, spot);
            if (cell) void pick(cell);
        },
        onHover: (spot) => setHovered(spot && cellAt(matrix, shown.current, size, spot)),
    });
    const told = hovered ?? picked;
    return <>
        <div class="canvas" ref={box}>
            <canvas
                ref={canvas} role="application" tabIndex={0} {...hand}
                aria-label={`Match matrix of ${plural(rows, "place")} by ${plural(columns, "place")}. Arrows move the cell, Enter opens its pair, plus and minus zoom, 0 shows all, shift and arrows move it.`}
            />
            <div class="zoom">
                <button type="button" aria-label="Zoom in to the matrix" onClick={() => zoom(1.4)}>+</button>
                <button type="button" aria-label="Zoom out of the matrix" onClick={() => zoom(1 / 1.4)}>−</button>
                <button type="button" aria-label="Show the whole matrix" title="The whole matrix (0)" onClick={whole}>⤢</button>
            </div>
        </div>
        <p class="told" data-testid="cell" data-tiles={changes} role="status">{told ? wordsOf(matrix, tiles, level(), told, data) : "Point at a cell, or move to one by the arrow keys."}</p>
        {tiles.error && <Refused error={tiles.error} />}
        <p class="legend">
            <span class="ramp" aria-hidden="true" /><span>0 nats and below to {count(Math.round(matrix.full_shade_nats))} and above: what the row’s place shows speaks for the column’s place</span>
            {itself && <><span class="key ring">loop closure</span><span class="key dot">other link</span></>}
        </p>
        {!itself && picked && <Across matrix={matrix} cell={picked} />}
    </>;
}

/** What a cell says, in words. */
function wordsOf(matrix: MatchMatrix, tiles: Tiles, level: number, cell: Cell, data: MapData): string {
    const cells = 2 ** level;
    const [from, to] = [matrix.rows!, matrix.columns!].map(({ place_numbers }, side) => {
        const first = Math.floor(cell[side]! / cells) * cells;
        const last = Math.min(first + cells, place_numbers.length) - 1;
        const [one, end] = [place_numbers[first]!, place_numbers[last]!];
        const map = side === 1 && matrix.against !== matrix.map ? ` of ${short(matrix.against)}` : "";
        return last === first ? `place ${one}${map}${map ? "" : frameOf(data, one)}` : `one of the places ${one} to ${end}${map}`;
    });
    const shade = shadeOf(matrix, tiles, level, cell);
    const nats = (matrix.full_shade_nats * (shade ?? 0)) / 255;
    const value = shade === null ? "…" : shade === 0 ? "nothing speaks for it" : shade === 255
        ? `${matrix.full_shade_nats.toFixed(0)} nats or more` : `${nats.toFixed(nats < 10 ? 1 : 0)} nats`;
    const joined = matrix.map !== matrix.against ? undefined : matrix.marks.find(({ row, column }) => {
        const within = (at: number, side: number) => at >= Math.floor(cell[side]! / cells) * cells && at < (Math.floor(cell[side]! / cells) + 1) * cells;
        return (within(row, 0) && within(column, 1)) || (within(column, 0) && within(row, 1));
    });
    return `What ${from} shows, for ${to}: ${value}${joined ? `; ${joined.kind === "loop_closure" ? "a loop was closed between them" : "linked"}` : ""}`;
}

function frameOf(data: MapData, number: number): string {
    const frame = data.placeOf(number)?.frames[0];
    return frame ? ` (${short(frame.session)}, frame ${frame.sequence})` : "";
}

/** Two places of two maps, side by side. */
function Across({ matrix, cell }: { matrix: MatchMatrix; cell: Cell }) {
    const places = [
        [short(matrix.map), matrix.rows!.place_numbers[cell[0]]!], [short(matrix.against), matrix.columns!.place_numbers[cell[1]]!],
    ] as const;
    const asked = useAsked((signal) => Promise.all(places.map(async ([map, number]) => {
        const { frames: [frame] } = await get<Place>(at(`maps/${map}/places/${number}`), signal);
        return { map, number, frame };
    })), [...places[0], ...places[1], matrix]);
    return <Shown asked={asked} what="the two places">{([one, other]) => <TwoPlaces one={one!} other={other!} />}</Shown>;
}

interface PlaceOfMap {
    map: string;
    number: number;
    frame: Place["frames"][number] | undefined;
}

/** What the first frames of the two places share. */
function TwoPlaces({ one, other }: { one: PlaceOfMap; other: PlaceOfMap }) {
    const [large, setLarge] = useState(false);
    const [frame, beside] = [one, other].map(({ frame }) => frame && `${frame.session}/frames/${frame.sequence}`);
    const path = frame && beside ? pairPath(frame, beside) : null;
    const alt = `Place ${one.number} of ${one.map} beside place ${other.number} of ${other.map}: what they share`;
    return <>
        {path && <button type="button" class="enlarge" aria-label={`Enlarge: ${alt}`} onClick={() => setLarge(true)}><Picture path={path} alt="" /></button>}
        {path && large && <Large path={path} alt={alt} as="fitted" onClose={() => setLarge(false)} />}
        <p class="across">{[one, other].map(({ map, number, frame }) => (
            <a key={map} href={hash({ ...START, page: "map", map, place: number, ...(frame && { session: short(frame.session), frame: frame.sequence }) })}>
                place {number} of {map}{frame && `, ${short(frame.session)}, frame ${frame.sequence}`}
            </a>
        ))}</p>
    </>;
}
