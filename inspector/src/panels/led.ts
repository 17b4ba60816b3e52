// Robots that are led along a map: as they are told of, with the routes that they follow.
import { useEffect, useRef, useState } from "preact/hooks";
import { all, at, type Navigation } from "../rest";

/** Without events robots are asked for so often; with them to learn which have gone, and which routes were planned anew. */
const POLL_MS = 1500;
const GONE_MS = 15_000;
/** Events leave routes out: after one that says that a robot goes another way, all are asked for so soon. */
const ROUTE_MS = 600;
/** A way that grows by this was planned anew. */
const LONGER_M = 0.5;

/** A robot that is led. */
export interface Led extends Navigation {
    /** When it last said something new, by this page's clock; `null` if it has not since the page is here. */
    heard_ms: number | null;
}

function heardOf(robot: Navigation, before: Led | undefined): number | null {
    const stamp = robot.guidance?.stamp_ns ?? null;
    const same = !before || stamp === null || stamp === before.guidance?.stamp_ns;
    return same ? (before?.heard_ms ?? null) : performance.now();
}

const sameGoal = (robot: Navigation, before: Navigation) => JSON.stringify(robot.goal) === JSON.stringify(before.goal);

/** Whether a robot goes another way than it did, as far as can be told without its route. */
function goesElse(robot: Navigation, before: Navigation | undefined): boolean {
    if (!robot.goal) return false;
    if (!before || !sameGoal(robot, before) || robot.guidance?.status !== before.guidance?.status) return true;
    return (robot.guidance?.remaining_m ?? 0) > (before.guidance?.remaining_m ?? 0) + LONGER_M;
}

export function useRobots(map: string, live: boolean) {
    const [known, setKnown] = useState<{ robots: Led[]; error: Error | null }>({ robots: [], error: null });
    const robots = useRef<Led[]>([]);
    const soon = useRef<() => void>(() => {});
    const show = (next: Led[]) => {
        robots.current = next;
        setKnown({ robots: next, error: null });
    };
    useEffect(() => {
        const gone = new AbortController();
        let timer = 0;
        let hurried = false;
        const ask = async () => {
            hurried = false;
            try {
                if (document.visibilityState === "visible") {
                    const path = `${at(map)}/navigations`;
                    const found = await all<"navigations", Navigation>(path, "navigations", gone.signal);
                    const before = new Map(robots.current.map((robot) => [robot.name, robot]));
                    if (!gone.signal.aborted) show(found.map((robot) => ({ ...robot, heard_ms: heardOf(robot, before.get(robot.name)) })));
                }
            } catch (error) {
                if (!gone.signal.aborted) setKnown((now) => ({ ...now, error: error as Error }));
            }
            if (gone.signal.aborted) return;
            clearTimeout(timer);
            timer = window.setTimeout(ask, hurried ? ROUTE_MS : live ? GONE_MS : POLL_MS);
        };
        soon.current = () => {
            if (hurried) return;
            hurried = true;
            clearTimeout(timer);
            timer = window.setTimeout(ask, ROUTE_MS);
        };
        void ask();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [map, live]);
    const hear = (robot: Navigation) => {
        const before = robots.current.find(({ name }) => name === robot.name);
        const others = robots.current.filter(({ name }) => name !== robot.name);
        const route = before && robot.goal && sameGoal(robot, before) ? before.route : null;
        show([...others, { ...robot, route, heard_ms: heardOf(robot, before) }].sort((a, b) => a.name < b.name ? -1 : 1));
        if (goesElse(robot, before)) soon.current();
    };
    return { ...known, hear };
}
