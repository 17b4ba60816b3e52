// The drawing of a map, with robots in it: how it is coloured, what is picked, who is sent where.
import { useContext, useEffect, useMemo, useState } from "preact/hooks";
import { MOST_DRIVES, type MapData } from "../drawing/data";
import { ring } from "../drawing/layout";
import type { Size, View } from "../drawing/paint";
import { drawn, LEAST_M } from "../drawing/residuals";
import {
    described, heardOfAnswer, heardOfLed, spotOfPlace, spotOfPose, standing, type Doing, type Heard, type Spot, type Standing,
} from "../drawing/robots";
import { asDriven, kindOf, type Scene } from "../drawing/scene";
import type { Colour, Go, Link, Shape } from "../link";
import { count, plural, Refused, Renewals } from "../parts";
import type { Schemas } from "../rest";
import { MapCanvas } from "./canvas";
import { ColourKeys } from "./keys";
import { useResiduals } from "./evidence";
import type { Live } from "./live";
import { SendHere, useSendable } from "./sending";

function routeOf(scene: Scene, { part, waypoints }: Schemas["Route"]): Spot[] {
    return waypoints.map(({ place_number, pose }) => spotOfPose(scene, part, pose) ?? spotOfPlace(scene, place_number)).filter((spot) => spot !== null);
}

/** Where robots stand in the drawing; one that says nothing new of it, where it did last. */
function useStanding(scene: Scene, { robots, streaming, open }: Live): Standing[] {
    // What was said of places that have other numbers by now is said of none.
    const renewals = useContext(Renewals);
    const last = useMemo(() => new Map<string, Heard>(), [renewals]);
    const stand = (name: string, doing: Doing, heard: Heard): Standing[] => {
        const here = standing(scene, name, doing, heard);
        if (here) last.set(name, heard);
        const before = last.get(name);
        const found = here ?? (before && standing(scene, name, doing, before)) ?? newestPlace(scene, name, doing, heard.place);
        return found ? [found] : [];
    };
    const found = [
        ...robots.flatMap((robot) => stand(robot.name, robot.connected ? "led" : "gone", heardOfLed(robot))),
        ...streaming.flatMap(({ session, frame }) => stand(session, "streams", heardOfAnswer(frame.answer))),
        ...open.flatMap(({ session, mode, last_answer }) => mode === "localize" && last_answer ? stand(session, "looks", heardOfAnswer(last_answer)) : []),
    ];
    const written = JSON.stringify(found);
    return useMemo(() => found, [written]);
}

/** At the last place before one that is not here yet. */
function newestPlace(scene: Scene, name: string, doing: Doing, place: number | null): Standing | null {
    const before = place === null ? undefined : scene.numbers.filter((number) => number < place).at(-1);
    return before === undefined ? null : standing(scene, name, doing, { pose: null, part: null, place: before });
}

interface DrawingProps {
    link: Link;
    go: Go;
    data: MapData;
    scene: Scene;
    place: number | null;
    heard: Live;
    /** On a narrow screen, choices and legend are folded away. */
    narrow: boolean;
    onPlace: (place: number) => void;
    onSeen: (view: View, size: Size) => void;
}

export function Drawing({ data, scene, link, go, place, heard, narrow, onPlace, onSeen }: DrawingProps) {
    const kind = kindOf(data);
    const colour: Colour = link.colour ?? (kind === "appearance" ? "space" : data.sessions.length > 1 ? "session" : "time");
    const [corrected, setCorrected] = useState(link.corrected);
    useEffect(() => setCorrected(link.corrected), [link.corrected]);
    const marked = place === null ? null : (scene.near(place) ?? null);
    const robots = useStanding(scene, heard);
    const routes = useMemo(
        () => heard.robots.flatMap(({ route }) => route ? [routeOf(scene, route)] : []),
        [scene, JSON.stringify(heard.robots.map(({ route }) => route))],
    );
    const wanted = kind === "metric" && link.residuals;
    const left = useResiduals(data, wanted);
    const found = wanted && left.state === "there" ? left.value : null;
    const most_m = found?.[0]?.off_m ?? 0;
    // Where all fit, what is left over is rounding: nothing is coloured.
    const residuals = useMemo(() => found && (most_m < LEAST_M ? [] : drawn(found, scene.near, most_m)), [found, scene]);
    const measured = (found?.length ?? 0) > 0;
    const look = useMemo(
        () => ({ colour, corrected, closures: link.closures, place: marked, robots, routes, residuals }),
        [colour, corrected, link.closures, marked, robots, routes, residuals],
    );
    const [alone, setAlone] = useState<number | null>(null);
    const sendable = useSendable(heard.robots);
    // Who follows has picked nothing by hand.
    const picked = link.place !== null && marked !== null && sendable.length > 0 && !link.follow && alone !== link.place;
    const view = useMemo(() => link.view && { x: link.view[0], y: link.view[1], scale: link.view[2] }, [link.view]);
    const words = { metric: "in metres", topological: "places in their order, without metres", appearance: "a graph of what places look like" }[kind];
    const driven = data.places.length > 0 && kind === "topological";
    const choices = <>
        <label>Colour <select value={colour} onChange={(event) => go({ colour: event.currentTarget.value as Colour })}>
            <option value="time">by time</option><option value="session">by session</option>
            <option value="space">{kind === "metric" ? "by part" : "by space"}</option>
        </select></label>
        {driven && <label>Shape <select value={asDriven(data, link.shape) === ring ? "ring" : "strip"} onChange={(event) => go({ shape: event.currentTarget.value as Shape })}>
            <option value="ring">ring</option><option value="strip">strip</option>
        </select></label>}
        {kind === "metric" && <label>Links <select value={link.residuals ? "residual" : "plain"} onChange={(event) => go({ residuals: event.currentTarget.value === "residual" })}>
            <option value="plain">all alike</option><option value="residual">by what is left over</option>
        </select></label>}
        {scene.closures.length > 0 && <label>Closures <select value={link.closures ? "shown" : "hidden"} onChange={(event) => go({ closures: event.currentTarget.value === "shown" })}>
            <option value="shown">shown</option><option value="hidden">hidden</option>
        </select></label>}
        {kind === "metric" && <label class="slider">wheels alone <input
            type="range" min={0} max={1} step={0.05} value={corrected} aria-label="From odometry alone to corrected"
            onInput={(event) => setCorrected(Number(event.currentTarget.value))}
            onChange={(event) => go({ corrected: Number(event.currentTarget.value) })}
        /> corrected</label>}
    </>;
    const legend = (
        <p class="legend">
            {!residuals && <ColourKeys colour={colour} data={data} scene={scene} />}
            {scene.links.length > 0 && !residuals?.length && <span class="key link">link</span>}
            {scene.closures.length > 0 && link.closures && <span class="key closure">loop closure, with a ring at the place that was known; thicker is surer, dashed below 0.9</span>}
            {robots.length > 0 && <span class="key robot">robot: the tip is where it looks, a disc if nobody knows; hollow if it is not connected</span>}
            {routes.length > 0 && <span class="key route">route of a robot, with a ring at its goal</span>}
            {wanted && left.state === "refused" && <Refused error={left.error} />}
            {residuals && <span data-testid="residuals">{!measured ? "no way was measured" : most_m < LEAST_M ? "every link fits to a millimetre" : <>left over: 0 m <span class="ramp worse" /> {most_m.toFixed(most_m < 1 ? 3 : 1)} m at worst, and the thicker</>}</span>}
            {kind === "metric" && corrected < 1 && <span class="key odometry">by wheels alone</span>}
            {data.every > 1 && <span data-testid="thinned">one of {data.every} places along the way; more where you zoom in</span>}
            {data.map.loop_closures > data.closures.length && <span>the first {count(data.closures.length)} closures</span>}
            {scene.unplaced > 0 && <span>{plural(scene.unplaced, "place")} without a pose not drawn</span>}
            {scene.parts > 1 && <span>{scene.parts} parts that nothing joins lie side by side</span>}
            {kind === "metric" && data.sessions.length > MOST_DRIVES && <span>ways of the first {MOST_DRIVES} sessions</span>}
        </p>
    );
    return (
        <section class="panel drawing" aria-label="The map">
            <header>
                <h2>Map</h2><span class="quiet" data-testid="kind">{words}</span>
                {!narrow && choices}
            </header>
            {data.places.length === 0 ? <p class="empty">This map has no places yet: a robot makes them while it streams.</p> : (
                <MapCanvas
                    scene={scene} look={look} view={view}
                    describe={`Drawing of the map with ${plural(scene.numbers.length, "place")}.${described(robots)} Plus and minus zoom, 0 shows all, shift and arrows move it.`}
                    onView={(view) => go({ view: view && [view.x, view.y, view.scale] })}
                    onPick={(index) => {
                        setAlone(null);
                        onPlace(scene.numbers[index]!);
                    }}
                    onSeen={onSeen}
                    beside={picked && <SendHere key={link.place} robots={sendable} place={link.place!} onClose={() => setAlone(link.place)} />}
                />
            )}
            {narrow ? (
                <details class="choices">
                    <summary>Legend and colours</summary>
                    <p class="choose">{choices}</p>
                    {legend}
                    <p class="quiet small">Two fingers move and zoom the drawing.</p>
                </details>
            ) : legend}
        </section>
    );
}
