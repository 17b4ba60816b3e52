// The map's drawing: pan by dragging, zoom by wheel, pinch or keys, pick a place.
import type { ComponentChildren } from "preact";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { ink } from "../drawing/colours";
import { between, type Scene } from "../drawing/scene";
import { fit, isSeen, MARGIN_PX, paint, placeAt, toScreen, type Look, type Size, type View } from "../drawing/paint";
import { listed } from "../drawing/robots";
import { useDark, useSize } from "../parts";
import { useHand } from "./hand";

interface CanvasProps {
    scene: Scene;
    look: Look;
    view: View | null;
    describe: string;
    onView: (view: View | null) => void;
    onPick: (index: number) => void;
    /** What is seen of the drawing, once it rests. */
    onSeen?: (view: View, size: Size) => void;
    /** What is shown beside the marked place. */
    beside?: ComponentChildren;
}

const REACH_PX = 16;
const ASIDE_PX = 16;
const EDGE_PX = 8;

/** Right below a point of the drawing, or above it where there is no room, and never out of sight. */
function moveBeside(note: HTMLElement, [x, y]: [number, number], { width, height }: Size) {
    const [wide, tall] = [note.offsetWidth, note.offsetHeight];
    const within = (wanted: number, most: number) => Math.min(Math.max(wanted, EDGE_PX), Math.max(most - EDGE_PX, EDGE_PX));
    const below = y + ASIDE_PX + tall <= height ? y + ASIDE_PX : y - ASIDE_PX - tall;
    note.style.transform = `translate(${within(x - wide / 2, width - wide)}px, ${within(below, height - tall)}px)`;
}

export function MapCanvas({ scene, look, view, describe, onView, onPick, onSeen, beside }: CanvasProps) {
    const [box, size] = useSize<HTMLDivElement>();
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    const shown = useRef<View>({ x: 0, y: 0, scale: 1 });
    const asked = useRef(0);
    const note = useRef<HTMLDivElement>(null);
    const points = useMemo(() => between(scene.odometry, scene.corrected, look.corrected), [scene, look.corrected]);

    const draw = () => {
        asked.current = 0;
        const context = canvas.current?.getContext("2d");
        if (!canvas.current || !context || !size.width) return;
        const sharp = devicePixelRatio || 1;
        const [width, height] = [Math.round(size.width * sharp), Math.round(size.height * sharp)];
        if (canvas.current.width !== width) canvas.current.width = width;
        if (canvas.current.height !== height) canvas.current.height = height;
        context.setTransform(sharp, 0, 0, sharp, 0, 0);
        const robots = paint(context, scene, look, shown.current, size, ink(canvas.current));
        if (note.current && look.place !== null) {
            const screen = toScreen(shown.current, size);
            moveBeside(note.current, [screen.x(points.x[look.place]!), screen.y(points.y[look.place]!)], size);
        }
        canvas.current.dataset["drawn"] = String(scene.numbers.length);
        canvas.current.dataset["robots"] = listed(look.robots, robots);
    };
    const redraw = () => {
        if (!asked.current) asked.current = requestAnimationFrame(() => latest.current());
    };
    const latest = useRef(draw);
    latest.current = draw;
    const whole = () => fit(scene, size, MARGIN_PX, look.robots.map(({ at }) => at));
    useEffect(() => {
        if (!size.width) return;
        shown.current = view ?? whole();
        redraw();
    }, [scene, look.corrected, view, size.width, size.height]);
    // What moves in the drawing leaves it in the hand where it is; only who sees all goes on to do so.
    useEffect(() => {
        if (size.width && !view && look.robots.some(({ at }) => !isSeen(at, shown.current, size)) && !busy()) shown.current = whole();
        redraw();
    }, [look, dark, beside]);
    useEffect(() => {
        if (size.width) onSeen?.(view ?? fit(scene, size), size);
    }, [view, size.width, size.height]);

    const { hand, zoom, all, busy } = useHand({
        canvas, size, shown, redraw, onView, scales: [1e-4, 2000],
        onClick: (spot) => {
            const found = placeAt(points, shown.current, size, spot, REACH_PX);
            if (found !== null) onPick(found);
        },
    });
    return (
        <div class="canvas" ref={box}>
            <canvas ref={canvas} role="application" tabIndex={0} aria-label={describe} {...hand} />
            {beside && <div class="beside" ref={note}>{beside}</div>}
            <div class="zoom">
                <button type="button" aria-label="Zoom in" onClick={() => zoom(1.4)}>+</button>
                <button type="button" aria-label="Zoom out" onClick={() => zoom(1 / 1.4)}>−</button>
                <button type="button" aria-label="Show the whole map" title="The whole map (0)" onClick={all}>⤢</button>
            </div>
        </div>
    );
}
