// A drawing in the hand: moved by dragging, zoomed by wheel, pinch or keys, asked by a click.
import { useEffect, useRef } from "preact/hooks";
import type { Size, View } from "../drawing/paint";

/** A finger or the mouse where it was last. */
type Held = Map<number, [number, number]>;

const CLICK_PX = 5;
const STEP_PX = 60;
const REST_MS = 250;

interface Holding {
    canvas: { current: HTMLCanvasElement | null };
    size: Size;
    /** What is seen now, ahead of what the link says. */
    shown: { current: View };
    scales: [least: number, most: number];
    redraw: () => void;
    onView: (view: View | null) => void;
    onClick: (spot: [number, number]) => void;
    /** Keys that the drawing itself wants; whether it did. */
    onKey?: (event: KeyboardEvent) => boolean;
    onHover?: (spot: [number, number] | null) => void;
}

export function useHand({ canvas, size, shown, scales: [least, most], redraw, onView, onClick, onKey, onHover }: Holding) {
    const held = useRef<Held>(new Map());
    const moved = useRef(0);
    const told = useRef(0);
    // While a hand moves the picture, only the picture is drawn; the link is told when it rests.
    const show = (next: View) => {
        shown.current = next;
        redraw();
        clearTimeout(told.current);
        told.current = window.setTimeout(() => {
            told.current = 0;
            onView(shown.current);
        }, REST_MS);
    };
    useEffect(() => () => clearTimeout(told.current), []);
    const began = useRef<View>(shown.current);
    // One finger scrolls the page, up and down; two are the drawing's, so the browser must not take them.
    useEffect(() => {
        const element = canvas.current;
        const two = (event: TouchEvent) => {
            if (event.touches.length > 1 && event.cancelable) event.preventDefault();
        };
        element?.addEventListener("touchstart", two, { passive: false });
        element?.addEventListener("touchmove", two, { passive: false });
        return () => {
            element?.removeEventListener("touchstart", two);
            element?.removeEventListener("touchmove", two);
        };
    }, []);
    const all = () => {
        clearTimeout(told.current);
        told.current = 0;
        onView(null);
    };
    const zoom = (times: number, px = size.width / 2, py = size.height / 2) => {
        const { x, y, scale } = shown.current;
        const to = Math.min(Math.max(scale * times, least), most);
        const kept = 1 / scale - 1 / to;
        show({ x: x + (px - size.width / 2) * kept, y: y - (py - size.height / 2) * kept, scale: to });
    };
    const pan = (dx: number, dy: number) => {
        const { x, y, scale } = shown.current;
        show({ x: x - dx / scale, y: y + dy / scale, scale });
    };
    const spot = (event: MouseEvent): [number, number] => {
        const at = (event.currentTarget as Element).getBoundingClientRect();
        return [event.clientX - at.left, event.clientY - at.top];
    };
    const hand = {
        onKeyDown: (event: KeyboardEvent) => {
            if (event.ctrlKey || event.metaKey || event.altKey) return;
            const does: Record<string, (() => void) | undefined> = {
                "+": () => zoom(1.3), "=": () => zoom(1.3), "-": () => zoom(1 / 1.3), "0": all,
                ...(event.shiftKey && {
                    ArrowLeft: () => pan(STEP_PX, 0), ArrowRight: () => pan(-STEP_PX, 0), ArrowUp: () => pan(0, STEP_PX),
                    ArrowDown: () => pan(0, -STEP_PX),
                }),
            };
            const act = does[event.key];
            if (act) act();
            else if (!onKey?.(event)) return;
            event.preventDefault();
            event.stopPropagation();
        },
        onWheel: (event: WheelEvent) => {
            event.preventDefault();
            zoom(Math.exp(-event.deltaY * 0.0015), ...spot(event));
        },
        onPointerDown: (event: PointerEvent) => {
            (event.currentTarget as Element).setPointerCapture(event.pointerId);
            if (held.current.size === 0) {
                moved.current = 0;
                began.current = shown.current;
            }
            held.current.set(event.pointerId, spot(event));
        },
        onPointerMove: (event: PointerEvent) => {
            const now = spot(event);
            const before = held.current.get(event.pointerId);
            if (!before) return onHover?.(now);
            const [other] = [...held.current].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
            held.current.set(event.pointerId, now);
            moved.current += Math.hypot(now[0] - before[0], now[1] - before[1]);
            if (!other) return pan(now[0] - before[0], now[1] - before[1]);
            const apart = (at: [number, number]) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
            pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
            zoom(apart(now) / apart(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
        },
        onPointerUp: (event: PointerEvent) => {
            const alone = held.current.size === 1;
            if (held.current.delete(event.pointerId) && alone && moved.current <= CLICK_PX) onClick(spot(event));
        },
        onPointerCancel: (event: PointerEvent) => {
            // The browser took the finger to scroll the page: the drawing is as before.
            if (held.current.delete(event.pointerId) && held.current.size === 0 && shown.current !== began.current) {
                clearTimeout(told.current);
                told.current = 0;
                shown.current = began.current;
                redraw();
            }
        },
        onPointerLeave: () => onHover?.(null),
    };
    /** Whether a hand moves it, or did a moment ago. */
    const busy = () => held.current.size > 0 || told.current !== 0;
    return { hand, zoom, show, all, busy };
}
