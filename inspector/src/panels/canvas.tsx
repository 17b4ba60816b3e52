// The map's drawing: pan by dragging, zoom by wheel, pinch or keys, pick a place.
import { useEffect, useMemo, useRef } from "preact/hooks";
import { ink } from "../drawing/colours";
import { between, type Scene } from "../drawing/scene";
import { fit, paint, placeAt, type Look, type View } from "../drawing/paint";
import { useDark, useSize } from "../parts";

interface CanvasProps {
    scene: Scene;
    look: Look;
    view: View | null;
    describe: string;
    onView: (view: View | null) => void;
    onPick: (index: number) => void;
}

/** A finger or the mouse where it was last. */
type Held = Map<number, [number, number]>;

const CLICK_PX = 5;
const REACH_PX = 16;

export function MapCanvas({ scene, look, view, describe, onView, onPick }: CanvasProps) {
    const [box, size] = useSize<HTMLDivElement>();
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    const shown = useRef<View>({ x: 0, y: 0, scale: 1 });
    const held = useRef<Held>(new Map());
    const moved = useRef(0);
    const asked = useRef(0);
    const told = useRef(0);
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
        paint(context, scene, look, shown.current, size, ink(canvas.current));
        canvas.current.dataset["drawn"] = String(scene.numbers.length);
    };
    const redraw = () => {
        if (!asked.current) asked.current = requestAnimationFrame(() => latest.current());
    };
    const latest = useRef(draw);
    latest.current = draw;
    useEffect(() => {
        if (!size.width) return;
        shown.current = view ?? fit(scene, size);
        redraw();
    }, [scene, look, view, size.width, size.height, dark]);

    // While a hand moves the picture, only the picture is drawn; the link is told when it rests.
    const show = (next: View) => {
        shown.current = next;
        redraw();
        clearTimeout(told.current);
        told.current = window.setTimeout(() => onView(shown.current), 250);
    };
    useEffect(() => () => clearTimeout(told.current), []);
    const zoom = (times: number, px = size.width / 2, py = size.height / 2) => {
        const { x, y, scale } = shown.current;
        const to = Math.min(Math.max(scale * times, 0.01), 2000);
        const kept = 1 / scale - 1 / to;
        show({ x: x + (px - size.width / 2) * kept, y: y - (py - size.height / 2) * kept, scale: to });
    };
    const pan = (dx: number, dy: number) => {
        const { x, y, scale } = shown.current;
        show({ x: x - dx / scale, y: y + dy / scale, scale });
    };
    const spot = (event: MouseEvent): [number, number] => {
        const at = canvas.current!.getBoundingClientRect();
        return [event.clientX - at.left, event.clientY - at.top];
    };
    const onMove = (event: PointerEvent) => {
        const before = held.current.get(event.pointerId);
        if (!before) return;
        const now = spot(event);
        const [other] = [...held.current].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
        held.current.set(event.pointerId, now);
        moved.current += Math.hypot(now[0] - before[0], now[1] - before[1]);
        if (!other) return pan(now[0] - before[0], now[1] - before[1]);
        const apart = (at: [number, number]) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
        zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    };
    const onUp = (event: PointerEvent) => {
        const alone = held.current.size === 1;
        if (!held.current.delete(event.pointerId) || !alone || moved.current > CLICK_PX) return;
        const found = placeAt(points, shown.current, size, spot(event), REACH_PX);
        if (found !== null) onPick(found);
    };
    const onKey = (event: KeyboardEvent) => {
        const far = 60;
        const does: Record<string, (() => void) | undefined> = {
            "+": () => zoom(1.3), "=": () => zoom(1.3), "-": () => zoom(1 / 1.3), "0": () => onView(null),
            ...(event.shiftKey && {
                ArrowLeft: () => pan(far, 0), ArrowRight: () => pan(-far, 0), ArrowUp: () => pan(0, far),
                ArrowDown: () => pan(0, -far),
            }),
        };
        const act = does[event.key];
        if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
        event.preventDefault();
        event.stopPropagation();
        act();
    };
    return (
        <div class="canvas" ref={box}>
            <canvas
                ref={canvas} role="application" tabIndex={0} aria-label={describe}
                onKeyDown={onKey}
                onWheel={(event) => {
                    event.preventDefault();
                    zoom(Math.exp(-event.deltaY * 0.0015), ...spot(event));
                }}
                onPointerDown={(event) => {
                    canvas.current!.setPointerCapture(event.pointerId);
                    if (held.current.size === 0) moved.current = 0;
                    held.current.set(event.pointerId, spot(event));
                }}
                onPointerMove={onMove} onPointerUp={onUp}
                onPointerCancel={(event) => held.current.delete(event.pointerId)}
            />
            <div class="zoom">
                <button type="button" aria-label="Zoom in" onClick={() => zoom(1.4)}>+</button>
                <button type="button" aria-label="Zoom out" onClick={() => zoom(1 / 1.4)}>−</button>
                <button type="button" aria-label="Show the whole map" title="The whole map (0)" onClick={() => onView(null)}>⤢</button>
            </div>
        </div>
    );
}
