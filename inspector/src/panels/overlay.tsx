// Maps drawn on each other where they have metres: as a merge lays them, or a person by hand.
import { useMemo, useState } from "preact/hooks";
import { colourNumber, laidByHand, loadLayers, overlaid, type Layer, type Overlaid } from "../drawing/overlay";
import type { Pose } from "../drawing/geometry";
import { hash, START, type Go, type Link } from "../link";
import { Refusal, short, type Merge } from "../rest";
import { plural, Shown, useAsked } from "../parts";
import { MapCanvas } from "./canvas";

interface OverlayProps {
    merge: Merge;
    link: Link;
    go: Go;
}

export function Overlay({ merge, link, go }: OverlayProps) {
    const asked = useAsked(async (signal) => {
        try {
            return await overlaid(merge, signal);
        } catch (error) {
            // A merge outlives its maps.
            if (error instanceof Refusal && error.code === "not_found") return error;
            throw error;
        }
    }, [merge.name, merge.state]);
    return (
        <section class="panel drawing" aria-label="The maps on each other">
            <header><h2>On each other</h2><span class="quiet">in metres, {merge.state === "committed" ? "as the merge has laid them" : merge.state === "proposed" ? "as the merge would lay them" : "as the search laid them"}</span></header>
            <Shown asked={asked} what="the maps">
                {(found) => found instanceof Error
                    ? <p class="quiet">They cannot be drawn any more: {found.message}</p>
                    : found.scene.numbers.length === 0
                        ? <p class="quiet">They cannot be drawn any more: their places are gone.</p>
                        : <Drawn found={found} link={link} go={go} />}
            </Shown>
        </section>
    );
}

interface ByHandProps {
    /** Their short names; the others are laid on the first. */
    maps: string[];
    link: Link;
    go: Go;
}

const LIES = ["x, m", "y, m", "turned, °"] as const;

/** Maps of which nobody has said how they lie: each at its own origin, and moved by the numbers of the link. */
export function ByHand({ maps, link, go }: ByHandProps) {
    const asked = useAsked((signal) => loadLayers(maps.map((map) => `maps/${map}`), signal), [maps.join(",")]);
    const lies = maps.slice(1).map((_, at) => link.laid?.[at] ?? ([0, 0, 0] as const));
    const move = (of: number, axis: number, value: number) =>
        go({ laid: lies.map((lie, at) => lie.map((known, on) => at === of && on === axis ? value : known) as [number, number, number]) });
    const frames = [[0, 0, 0] as const, ...lies].map(([x, y, degrees]) => ({ x, y, heading: (degrees * Math.PI) / 180 }));
    return (
        <section class="panel drawing" aria-label="The maps on each other">
            <header><h2>On each other</h2><span class="quiet">in metres, each at its own origin; moved by hand, which changes none of them</span></header>
            {lies.map((lie, of) => (
                <p key={maps[of + 1]} class="making"><strong>{maps[of + 1]}</strong>{LIES.map((words, axis) => (
                    <label key={words}>{words} <input class="few" type="number" step={axis === 2 ? 5 : 0.5} value={lie[axis]} aria-label={`${maps[of + 1]} ${words}`} onChange={(event) => move(of, axis, Number(event.currentTarget.value) || 0)} /></label>
                ))}</p>
            ))}
            <Shown asked={asked} what="the maps">
                {(layers) => <Laid layers={layers} frames={frames} link={link} go={go} />}
            </Shown>
        </section>
    );
}

function Laid({ layers, frames, link, go }: { layers: Layer[]; frames: Pose[] } & Omit<OverlayProps, "merge">) {
    const found = useMemo(() => laidByHand(layers, frames), [layers, JSON.stringify(frames)]);
    return found.scene.numbers.length === 0 ? <p class="quiet">None of them has places in metres.</p> : <Drawn found={found} link={link} go={go} />;
}

function Drawn({ found, link, go }: { found: Overlaid } & Omit<OverlayProps, "merge">) {
    const { scene, layerOf, sessionOf, maps, absent, cut } = found;
    const [picked, setPicked] = useState<number | null>(null);
    const look = useMemo(() => ({ colour: "session" as const, corrected: 1, closures: true, place: picked, robots: [], routes: [], residuals: null }), [picked]);
    const view = useMemo(() => link.view && { x: link.view[0], y: link.view[1], scale: link.view[2] }, [link.view]);
    const empty = maps.filter((_, layer) => !layerOf.includes(layer)).map(({ map }) => short(map));
    const map = picked === null ? null : short(maps[layerOf[picked]!]!.map);
    const session = picked === null ? "" : sessionOf[picked]!;
    return <>
        <MapCanvas
            scene={scene} look={look} view={view}
            describe={`Drawing of ${plural(maps.length, "map")} on each other with ${plural(scene.numbers.length, "place")}. Plus and minus zoom, 0 shows all, shift and arrows move it.`}
            onView={(view) => go({ view: view && [view.x, view.y, view.scale] })} onPick={setPicked}
        />
        <p class="legend">
            {maps.map(({ map, sessions }, at) => (
                <span key={map} class={`key map-${colourNumber(at)}`}>{short(map)}{at === 0 && ", the base"}: {sessions.length === 0 ? "no session" : sessions.map(({ name }) => short(name)).join(", ")}</span>
            ))}
            {maps.length > 1 && <span>what lies below is drawn larger</span>}
            {scene.closures.length > 0 && <span class="key closure">match</span>}
            {map !== null && <a href={hash({ ...START, page: "map", map, place: scene.numbers[picked!]! })}>place {scene.numbers[picked!]} of {map}{session && `, ${short(session)}`}</a>}
            {empty.length > 0 && <span>no places there any more: {empty.join(", ")}</span>}
            {absent.length > 0 && <span>not drawn, for want of metres or on another part: {absent.map(short).join(", ")}</span>}
            {cut && <span>the first places of large maps</span>}
        </p>
    </>;
}
