// Robots that are led now, wherever somebody has scrolled to: where each is, and what stops it.
import { useState } from "preact/hooks";
import { at, change, short } from "../rest";
import { Refused, useMay } from "../parts";
import type { Led } from "./led";
import { PlaceLink } from "./pair";
import { goalText } from "./robots";

interface LeadingProps {
    robots: Led[];
    onPlace: (place: number) => void;
}

export function Leading({ robots, onPlace }: LeadingProps) {
    const led = robots.filter(({ connected }) => connected);
    if (led.length === 0) return null;
    return <section class="leading" aria-label="Led now">{led.map((robot) => <One key={robot.name} robot={robot} onPlace={onPlace} />)}</section>;
}

function One({ robot, onPlace }: { robot: Led } & Pick<LeadingProps, "onPlace">) {
    const [refused, setRefused] = useState<Error | null>(null);
    const may = useMay("navigate");
    const { guidance, goal } = robot;
    const place = guidance?.localization?.place_number ?? null;
    const stop = () => {
        setRefused(null);
        change("DELETE", `${at(robot.name)}/goal`).catch(setRefused);
    };
    return (
        <div class="one">
            <strong>{short(robot.name)}</strong> <span class={`reason ${guidance?.status ?? ""}`}>{guidance?.status ?? "no word yet"}</span>
            <span class="where">{place === null ? "place unknown" : <>at <PlaceLink number={place} onPlace={onPlace} /></>}{goal && `, goes to ${goalText(goal)}`}</span>
            {may && <button type="button" class="stop" disabled={!goal} title={goal ? "It loses its goal and stands" : "It has no goal: it stands"} onClick={stop}>Stop {short(robot.name)}</button>}
            {refused && <Refused error={refused} />}
        </div>
    );
}
