// The map's drawing: pan by dragging, zoom by wheel, pinch or keys, pick a place.
import { useEffect, useMemo, useRef } from "preact/hooks";
import { ink } from "../drawing/colours";
import { between, type Scene } from "../drawing/scene";
import { fit, paint, placeAt, type Look, type Size, type View } from "../drawing/paint";
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
}

const REACH_PX = 16;

export function MapCanvas({ scene, look, view, describe, onView, onPick, onSeen }: CanvasProps) {
    const [box, size] = useSize<HTMLDivElement>();
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    const shown = useRef<View>({ x: 0, y: 0, scale: 1 });
    const asked = useRef(0);
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
    useEffect(() => {
        if (size.width) onSeen?.(view ?? fit(scene, size), size);
    }, [view, size.width, size.height]);

    const { hand, zoom, all } = useHand({
        size, shown, redraw, onView, scales: [1e-4, 2000],
        onClick: (spot) => {
            const found = placeAt(points, shown.current, size, spot, REACH_PX);
            if (found !== null) onPick(found);
        },
    });
    return (
        <div class="canvas" ref={box}>
            <canvas ref={canvas} role="application" tabIndex={0} aria-label={describe} {...hand} />
            <div class="zoom">
                <button type="button" aria-label="Zoom in" onClick={() => zoom(1.4)}>+</button>
                <button type="button" aria-label="Zoom out" onClick={() => zoom(1 / 1.4)}>−</button>
                <button type="button" aria-label="Show the whole map" title="The whole map (0)" onClick={all}>⤢</button>
            </div>
        </div>
    );
}
