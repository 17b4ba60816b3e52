// A place that was picked, and the robots that can be sent there: beside the place in the drawing.
import { useEffect, useState } from "preact/hooks";
import { at, change, short } from "../rest";
import { Refused, useMay } from "../parts";
import type { Led } from "./led";

/** Of more robots, the panel of robots has the rest. */
const MOST_ROBOTS = 4;
/** How long it says that a robot was sent. */
const SENT_MS = 3000;

interface SendingProps {
    robots: Led[];
    place: number;
    onClose: () => void;
}

/** Whether there is somebody to be sent, and somebody who may. */
export function useSendable(robots: Led[]): Led[] {
    const may = useMay("navigate");
    return may ? robots.filter(({ connected }) => connected) : [];
}

export function SendHere({ robots, place, onClose }: SendingProps) {
    const [refused, setRefused] = useState<Error | null>(null);
    const [sent, setSent] = useState<string | null>(null);
    const send = async (robot: Led) => {
        setRefused(null);
        await change("PUT", `${at(robot.name)}/goal`, { place_number: place }).then(() => setSent(short(robot.name)), setRefused);
    };
    // It would hide the route.
    useEffect(() => {
        if (sent === null) return;
        const timer = window.setTimeout(onClose, SENT_MS);
        return () => clearTimeout(timer);
    }, [sent]);
    return <>
        <strong>Place {place}</strong>
        {sent === null && robots.slice(0, MOST_ROBOTS).map((robot) => <button key={robot.name} type="button" onClick={() => void send(robot)}>Send {short(robot.name)} here</button>)}
        {refused ? <Refused error={refused} /> : <span role="status">{sent !== null && `${sent} is sent here`}</span>}
        <button type="button" class="close" aria-label={`Close what is beside place ${place}`} title="Close" onClick={onClose}>✕</button>
    </>;
}
