// Robots that are led along the map: where they are, where they go, and what takes their goal away.
import { useEffect, useState } from "preact/hooks";
import { at, change, short, type FrameAnswer, type Navigation, type OpenStream } from "../rest";
import type { Sequence } from "../sequence";
import { count, Refused, share, useMay } from "../parts";
import type { Led } from "./led";
import type { Live, Streaming } from "./live";
import { PlaceLink } from "./pair";
import { REASONS } from "./steps";

interface RobotsProps {
    heard: Live;
    place: number | null;
    onPlace: (place: number) => void;
    onFrame: (session: string, sequence: Sequence) => void;
}

export function Robots({ heard: { robots, streaming, open, live, error }, place, onPlace, onFrame }: RobotsProps) {
    // What is heard of a stream goes on for a moment after it has ended.
    const of = new Map(open.map((stream) => [stream.session, stream]));
    const heard = new Map(streaming.map((one) => [one.session, one]));
    const sessions = [...new Set([...of.keys(), ...heard.keys()])];
    return (
        <section class="panel robots" aria-label="Robots">
            <header><h2>Robots</h2><span class="quiet" data-testid="live">{live ? "live" : "asked for again and again"}</span></header>
            {error && <Refused error={error} />}
            {robots.length + sessions.length === 0 && !error && <p class="quiet">No robot is led along this map or streams into it now.</p>}
            {robots.map((robot) => <Robot key={robot.name} robot={robot} place={place} onPlace={onPlace} />)}
            {sessions.map((session) => (
                <Stream key={session} session={session} open={of.get(session) ?? null} heard={heard.get(session) ?? null} onPlace={onPlace} onFrame={onFrame} />
            ))}
        </section>
    );
}

interface StreamProps extends Pick<RobotsProps, "onPlace" | "onFrame"> {
    session: string;
    open: OpenStream | null;
    heard: Streaming | null;
}

/** A robot that streams into a session, or did a moment ago. One that only looks adds no frames to the map. */
function Stream({ session, open, heard, onPlace, onFrame }: StreamProps) {
    const answer = heard?.frame.answer ?? open?.last_answer ?? null;
    const sequence = heard ? short(heard.frame.name) : null;
    const looks = open?.mode === "localize";
    return (
        <article class="robot">
            <h3>{short(session)} <span class={`reason ${answer?.reason ?? ""}`}>{REASONS[answer?.reason ?? ""] ?? (looks ? "looks" : "streams")}</span></h3>
            <dl class="facts">
                {sequence !== null && <div><dt>streams</dt><dd><button type="button" class="link" onClick={() => onFrame(session, sequence)}>frame {sequence}</button></dd></div>}
                {answer && <div><dt>is at</dt><dd>{typeof answer?.place_number === "number" ? <PlaceLink number={answer.place_number} onPlace={onPlace} /> : "unknown"}</dd></div>}
                {heard && heard.frames > 1 && <Recognised of={heard.frames} recognitions={heard.recognitions} what="frames heard" />}
                {answer && <div><dt>last probability</dt><dd>{sureOf(answer)}</dd></div>}
                {open && <div><dt>frames</dt><dd>{count(open.answered_frames)} answered{open.refused_frames > 0 && `, ${count(open.refused_frames)} refused`}</dd></div>}
                {typeof open?.last_delay_ns === "number" && <div><dt>decided in</dt><dd>{(open.last_delay_ns / 1e6).toFixed(0)} ms</dd></div>}
                {heard && <div><dt>last word</dt><dd><Since heard_ms={heard.heard_ms} /></dd></div>}
            </dl>
        </article>
    );
}

/** What speaks for the last decision. */
function sureOf({ match, reason, places, new_place_posterior }: FrameAnswer): string {
    if (match?.geometry) return `${share(match.geometry.probability)}, by words and views`;
    const [likely] = places;
    if (reason === "new_place" && (!likely || likely.posterior < new_place_posterior)) return `${share(new_place_posterior)}, somewhere new`;
    return likely ? `${share(likely.posterior)}, place ${likely.place_number} by words` : "none";
}

/** How many places were recognised, of the frames that were looked at. */
function Recognised({ of, recognitions, what }: { of: number; recognitions: number; what: string }) {
    return <div><dt>recognised</dt><dd>{count(recognitions)} of {count(of)} {what}{of > 0 && ` (${Math.round((100 * recognitions) / of)} %)`}</dd></div>;
}

/** How long ago something was heard; it goes on by itself. */
function Since({ heard_ms }: { heard_ms: number | null }) {
    const [now, setNow] = useState(performance.now());
    useEffect(() => {
        setNow(performance.now());
        const timer = window.setInterval(() => setNow(performance.now()), 1000);
        return () => clearInterval(timer);
    }, [heard_ms]);
    return <>{heard_ms === null ? "none since this page is open" : `${(Math.max(now - heard_ms, 0) / 1000).toFixed(0)} s ago`}</>;
}

function Robot({ robot, place, onPlace }: { robot: Led } & Pick<RobotsProps, "place" | "onPlace">) {
    const [refused, setRefused] = useState<Error | null>(null);
    const maySend = useMay("navigate");
    const { guidance, goal, connected } = robot;
    const number = guidance?.localization?.place_number ?? null;
    const send = (method: "PUT" | "DELETE", body?: unknown) => {
        setRefused(null);
        change(method, `${at(robot.name)}/goal`, body).catch(setRefused);
    };
    return (
        <article class={connected ? "robot" : "robot gone"}>
            <h3>{short(robot.name)} <span class={`reason ${guidance?.status ?? ""}`}>{connected ? (guidance?.status ?? "no word yet") : "not connected"}</span></h3>
            {guidance?.detail && <p>{guidance.detail}</p>}
            <dl class="facts">
                <div><dt>is at</dt><dd>{number === null ? "unknown" : <PlaceLink number={number} onPlace={onPlace} />}</dd></div>
                {guidance?.localization && <div><dt>confidence</dt><dd>{share(guidance.localization.confidence)}</dd></div>}
                {robot.frames > 0 && <Recognised of={robot.frames} recognitions={robot.recognitions} what="frames" />}
                {guidance?.localization && <div><dt>last recognised</dt><dd>{(guidance.localization.since_recognition_ns / 1e9).toFixed(1)} s and {guidance.localization.since_recognition_m.toFixed(1)} m before its last word</dd></div>}
                <div><dt>last word</dt><dd><Since heard_ms={robot.heard_ms} /></dd></div>
                <div><dt>goes to</dt><dd>{goalText(goal)}</dd></div>
                {typeof guidance?.remaining_m === "number" && <div><dt>still to go</dt><dd>{guidance.remaining_m.toFixed(1)} m</dd></div>}
            </dl>
            {robot.goal_refusal?.status && <p class="refused">{robot.goal_refusal.status.message}</p>}
            {maySend && <p class="actions">
                <button type="button" class="stop" disabled={!goal || !connected} onClick={() => send("DELETE")}>Cancel its goal: stop</button>
                {place !== null && <button type="button" disabled={!connected} onClick={() => send("PUT", { place_number: place })}>Send to place {place}</button>}
                {!connected && <span class="quiet small">It is not connected: it would not hear of it.</span>}
            </p>}
            {refused && <Refused error={refused} />}
        </article>
    );
}

/** Where a robot goes, in words. */
export function goalText(goal: Navigation["goal"]): string {
    if (!goal) return "nowhere";
    if (goal.label) return goal.label;
    if (typeof goal.place_number === "number") return `place ${goal.place_number}`;
    const { x_m = null, y_m = null } = goal.position ?? {};
    return x_m !== null && y_m !== null ? `${x_m.toFixed(1)}, ${y_m.toFixed(1)} m` : "nowhere";
}
