// Large maps are thinned along the way; where somebody looks closely, the server is asked for more.
import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { closer as ask, withMore, type MapData, type Stretch } from "../drawing/data";
import { toScreen, type Size, type View } from "../drawing/paint";
import { sceneOf, type Scene } from "../drawing/scene";
import type { Shape } from "../link";
import type { Place } from "../rest";

/** Most places that are drawn of what is seen. */
const MOST_SEEN = 6000;
/** Less than this many times finer is not worth the wait. */
const FINER = 1.5;

const NONE: Place[] = [];

/** The map with what is seen of it in more detail, and its drawing. */
export function useCloser(data: MapData, renewals: number, shape: Shape | null) {
    const [{ places, of }, setMore] = useState({ places: NONE, of: renewals });
    // Places of before a renewal may be gone or have other numbers, and of a map that is here as a whole there are no more.
    const more = of === renewals && data.every > 1 ? places : NONE;
    const closer = useMemo(() => more.length > 0 ? withMore(data, more) : data, [data, more]);
    const scene = useMemo(() => sceneOf(closer, shape), [closer, shape]);
    const gone = useRef(new AbortController());
    useEffect(() => () => gone.current.abort(), []);
    const last = useRef<[View, Size] | null>(null);
    const look = (view: View, size: Size): boolean => {
        last.current = [view, size];
        gone.current.abort();
        if (data.every === 1) return false;
        const { count, stretches } = seen(scene, data, view, size);
        const every = Math.max(Math.ceil((count * data.every) / MOST_SEEN), 1);
        if (stretches.length === 0 || every * FINER > data.every) return false;
        const asking = gone.current = new AbortController();
        ask(data.map.name, every, stretches, asking.signal).then(
            (places) => asking.signal.aborted || setMore({ places, of: renewals }),
            // What is shown stays; another look asks again.
            () => {},
        );
        return true;
    };
    // Of a map that is another by now, or has grown, what is seen is another, too.
    useEffect(() => {
        if (last.current && !look(...last.current)) setMore({ places: NONE, of: renewals });
    }, [data]);
    return { closer, scene, onSeen: (view: View, size: Size) => void look(view, size) };
}

/** How many of the thinned places are seen, and which stretches of the map they lie in. */
function seen(scene: Scene, { every }: MapData, view: View, size: Size): { count: number; stretches: Stretch[] } {
    const screen = toScreen(view, size);
    const { x, y } = scene.corrected;
    const inView = (at: number) => {
        const [px, py] = [screen.x(x[at]!), screen.y(y[at]!)];
        return px >= 0 && py >= 0 && px <= size.width && py <= size.height;
    };
    let count = 0;
    const parts = new Set<number>();
    let [first, last] = [Infinity, -Infinity];
    scene.numbers.forEach((number, at) => {
        if (!inView(at)) return;
        parts.add(scene.spaceOf[at]!);
        first = Math.min(first, number);
        last = Math.max(last, number);
        // What was asked for besides counts as what it was thinned from.
        if (number % every === 0) count++;
    });
    const [half, tall] = [size.width / 2 / view.scale, size.height / 2 / view.scale];
    if (scene.kind === "metric") {
        // Closer than the thinned ones lie apart, none of them may be seen: then all parts are asked.
        const asked = parts.size > 0 ? [...parts] : [...scene.apart.keys()];
        return { count, stretches: asked.map((part) => {
            const aside = scene.apart.get(part) ?? 0;
            return {
                part, min_x_m: view.x - half - aside, max_x_m: view.x + half - aside, min_y_m: view.y - tall, max_y_m: view.y + tall,
            };
        }) };
    }
    if (count === 0) return { count, stretches: [] };
    return { count, stretches: [{ from_place_number: Math.max(first - every, 0), to_place_number: last + every }] };
}
