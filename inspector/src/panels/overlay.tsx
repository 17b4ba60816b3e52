// The maps of a proposed merge, drawn on each other where they have metres.
import { useMemo, useState } from "preact/hooks";
import { colourNumber, overlaid, type Overlaid } from "../drawing/overlay";
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
            <span class="key closure">match</span>
            {map !== null && <a href={hash({ ...START, page: "map", map, place: scene.numbers[picked!]! })}>place {scene.numbers[picked!]} of {map}{session && `, ${short(session)}`}</a>}
            {empty.length > 0 && <span>no places there any more: {empty.join(", ")}</span>}
            {absent.length > 0 && <span>not drawn, for want of metres or on another part: {absent.map(short).join(", ")}</span>}
            {cut && <span>the first places of large maps</span>}
        </p>
    </>;
}
