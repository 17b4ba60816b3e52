// The drawing of a map, with robots in it: how it is coloured, what is picked, who is sent where.
import { useEffect, useMemo, useState } from "preact/hooks";
import { MOST_DRIVES, type MapData } from "../drawing/data";
import { pose } from "../drawing/geometry";
import { ring } from "../drawing/layout";
import type { Size, View } from "../drawing/paint";
import { drawn, LEAST_M } from "../drawing/residuals";
import { asDriven, kindOf, type Scene } from "../drawing/scene";
import type { Colour, Go, Link, Shape } from "../link";
import { count, plural, Refused } from "../parts";
import type { Navigation, Schemas } from "../rest";
import { MapCanvas } from "./canvas";
import { useResiduals } from "./evidence";
import type { Live } from "./live";
import { SendHere, useSendable } from "./sending";

type Spot = [x: number, y: number];

function spotOfPlace(scene: Scene, number: number | null | undefined): Spot | null {
    const at = typeof number === "number" ? scene.near(number) : undefined;
    return at === undefined ? null : [scene.corrected.x[at]!, scene.corrected.y[at]!];
}

/** A pose of a part of the map in the drawing, where parts lie side by side. */
function spotOfPose(scene: Scene, part: number | null | undefined, given: Schemas["Pose"] | null): Spot | null {
    const at = scene.kind === "metric" ? pose(given) : null;
    return at && [at.x + (scene.apart.get(part ?? 0) ?? 0), at.y];
}

function spotOf(scene: Scene, { guidance }: Navigation): Spot | null {
    const here = guidance?.localization;
    return (here ? spotOfPose(scene, here.part, here.pose) : null) ??
        spotOfPlace(scene, here?.place_number ?? guidance?.appearance?.subgoal_place_number);
}

function routeOf(scene: Scene, { part, waypoints }: Schemas["Route"]): Spot[] {
    return waypoints.map(({ place_number, pose }) => spotOfPose(scene, part, pose) ?? spotOfPlace(scene, place_number)).filter((spot) => spot !== null);
}

interface DrawingProps {
    link: Link;
    go: Go;
    data: MapData;
    scene: Scene;
    place: number | null;
    heard: Live;
    onPlace: (place: number) => void;
    onSeen: (view: View, size: Size) => void;
}

export function Drawing({ data, scene, link, go, place, heard, onPlace, onSeen }: DrawingProps) {
    const kind = kindOf(data);
    const colour: Colour = link.colour ?? (kind === "appearance" ? "space" : data.sessions.length > 1 ? "session" : "time");
    const [corrected, setCorrected] = useState(link.corrected);
    useEffect(() => setCorrected(link.corrected), [link.corrected]);
    const marked = place === null ? null : (scene.near(place) ?? null);
    const where = [...heard.robots.map((robot) => spotOf(scene, robot)), ...heard.streaming.map(({ frame }) => spotOfPlace(scene, frame.answer?.place_number))]
        .filter((spot) => spot !== null);
    const routes = useMemo(
        () => heard.robots.flatMap(({ route }) => route ? [routeOf(scene, route)] : []),
        [scene, JSON.stringify(heard.robots.map(({ route }) => route))],
    );
    const wanted = kind === "metric" && link.residuals;
    const left = useResiduals(data, wanted);
    const found = wanted && left.state === "there" ? left.value : null;
    const most_m = found?.[0]?.off_m ?? 0;
    const residuals = useMemo(() => found && drawn(found, scene.near, most_m), [found, scene]);
    const spots = JSON.stringify(where);
    const look = useMemo(
        () => ({ colour, corrected, place: marked, robots: where, routes, residuals }),
        [colour, corrected, marked, spots, routes, residuals],
    );
    const sendable = useSendable(heard.robots);
    const picked = link.place !== null && marked !== null && sendable.length > 0;
    const view = useMemo(() => link.view && { x: link.view[0], y: link.view[1], scale: link.view[2] }, [link.view]);
    const words = { metric: "in metres", topological: "places in their order, without metres", appearance: "a graph of what places look like" }[kind];
    const driven = data.places.length > 0 && kind === "topological";
    return (
        <section class="panel drawing" aria-label="The map">
            <header>
                <h2>Map</h2><span class="quiet" data-testid="kind">{words}</span>
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
                {kind === "metric" && <label class="slider">wheels alone <input
                    type="range" min={0} max={1} step={0.05} value={corrected} aria-label="From odometry alone to corrected"
                    onInput={(event) => setCorrected(Number(event.currentTarget.value))}
                    onChange={(event) => go({ corrected: Number(event.currentTarget.value) })}
                /> corrected</label>}
            </header>
            {data.places.length === 0 ? <p class="empty">This map has no places yet: a robot makes them while it streams.</p> : (
                <MapCanvas
                    scene={scene} look={look} view={view}
                    describe={`Drawing of the map with ${plural(scene.numbers.length, "place")}. Plus and minus zoom, 0 shows all, shift and arrows move it.`}
                    onView={(view) => go({ view: view && [view.x, view.y, view.scale] })}
                    onPick={(index) => onPlace(scene.numbers[index]!)} onSeen={onSeen}
                    beside={picked && <SendHere key={link.place} robots={sendable} place={link.place!} />}
                />
            )}
            <p class="legend"><span class="key link">link</span><span class="key closure">loop closure; thicker is surer, dashed below 0.9</span>
                {routes.length > 0 && <span class="key route">route of a robot, with a ring at its goal</span>}
                {wanted && left.state === "refused" && <Refused error={left.error} />}
                {residuals && <span data-testid="residuals">{residuals.length === 0 ? "no way was measured" : most_m < LEAST_M ? "every link fits to a millimetre" : <>left over: 0 m <span class="ramp worse" /> {most_m.toFixed(most_m < 1 ? 3 : 1)} m at worst, and the thicker</>}</span>}
                {kind === "metric" && corrected < 1 && <span class="key odometry">by wheels alone</span>}
                {data.every > 1 && <span data-testid="thinned">one of {data.every} places along the way; more where you zoom in</span>}
                {data.map.loop_closures > data.closures.length && <span>the first {count(data.closures.length)} closures</span>}
                {scene.unplaced > 0 && <span>{plural(scene.unplaced, "place")} without a pose not drawn</span>}
                {scene.parts > 1 && <span>{scene.parts} parts that nothing joins lie side by side</span>}
                {kind === "metric" && data.sessions.length > MOST_DRIVES && <span>ways of the first {MOST_DRIVES} sessions</span>}
            </p>
        </section>
    );
}
