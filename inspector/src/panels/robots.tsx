// Robots that are led along the map: where they are, where they go, and what takes their goal away.
import { useEffect, useState } from "preact/hooks";
import { all, at, change, short, type Navigation } from "../rest";
import { Refused, share } from "../parts";
import { PlaceLink } from "./pair";

/** Robots move: how often they are asked for, while the page is looked at. */
const EVERY_MS = 1500;

export function useRobots(map: string): { robots: Navigation[]; error: Error | null } {
    const [known, setKnown] = useState<{ robots: Navigation[]; error: Error | null }>({ robots: [], error: null });
    useEffect(() => {
        const gone = new AbortController();
        let timer = 0;
        const ask = async () => {
            try {
                if (document.visibilityState === "visible") {
                    const path = `${at(map)}/navigations`;
                    const robots = await all<"navigations", Navigation>(path, "navigations", gone.signal);
                    if (!gone.signal.aborted) setKnown({ robots, error: null });
                }
            } catch (error) {
                if (!gone.signal.aborted) setKnown((now) => ({ ...now, error: error as Error }));
            }
            if (!gone.signal.aborted) timer = window.setTimeout(ask, EVERY_MS);
        };
        void ask();
        return () => {
            gone.abort();
            clearTimeout(timer);
        };
    }, [map]);
    return known;
}

interface RobotsProps {
    robots: Navigation[];
    error: Error | null;
    place: number | null;
    onPlace: (place: number) => void;
}

export function Robots({ robots, error, place, onPlace }: RobotsProps) {
    return (
        <section class="panel robots" aria-label="Robots">
            <header><h2>Robots</h2></header>
            {error && <Refused error={error} />}
            {robots.length === 0 && !error && <p class="quiet">No robot is led along this map now.</p>}
            {robots.map((robot) => <Robot key={robot.name} robot={robot} place={place} onPlace={onPlace} />)}
        </section>
    );
}

function Robot({ robot, place, onPlace }: { robot: Navigation } & Pick<RobotsProps, "place" | "onPlace">) {
    const [refused, setRefused] = useState<Error | null>(null);
    const { guidance, goal, connected } = robot;
    const number = guidance?.localization?.place_number ?? null;
    const send = (method: "PUT" | "DELETE", body?: unknown) => {
        setRefused(null);
        change(method, `${at(robot.name)}/goal`, body).catch(setRefused);
    };
    return (
        <article class="robot">
            <h3>{short(robot.name)} <span class={`reason ${guidance?.status ?? ""}`}>{connected ? (guidance?.status ?? "no word yet") : "not connected"}</span></h3>
            {guidance?.detail && <p>{guidance.detail}</p>}
            <dl class="facts">
                <div><dt>is at</dt><dd>{number === null ? "unknown" : <PlaceLink number={number} onPlace={onPlace} />}</dd></div>
                {guidance?.localization && <div><dt>confidence</dt><dd>{share(guidance.localization.confidence)}</dd></div>}
                <div><dt>goes to</dt><dd>{goalText(goal)}</dd></div>
                {typeof guidance?.remaining_m === "number" && <div><dt>still to go</dt><dd>{guidance.remaining_m.toFixed(1)} m</dd></div>}
            </dl>
            {robot.goal_refusal?.status && <p class="refused">{robot.goal_refusal.status.message}</p>}
            <p class="actions">
                <button type="button" class="stop" disabled={!goal} onClick={() => send("DELETE")}>Cancel its goal: stop</button>
                {place !== null && <button type="button" onClick={() => send("PUT", { place_number: place })}>Send to place {place}</button>}
            </p>
            {refused && <Refused error={refused} />}
        </article>
    );
}

function goalText(goal: Navigation["goal"]): string {
    if (!goal) return "nowhere";
    if (goal.label) return goal.label;
    if (typeof goal.place_number === "number") return `place ${goal.place_number}`;
    return goal.position ? `${goal.position.x_m.toFixed(1)}, ${goal.position.y_m.toFixed(1)} m` : "nowhere";
}
