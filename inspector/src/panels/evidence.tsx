// What holds the map together: its closures, the least sure first, and its links, the worst first.
import { useState } from "preact/hooks";
import { residuals } from "../drawing/residuals";
import type { MapData } from "../drawing/data";
import { sure } from "../drawing/scene";
import { at, download, short, text } from "../rest";
import type { Sequence } from "../sequence";
import { plural, share, Shown, useAsked } from "../parts";
import { PlaceLink } from "./pair";

const MOST_ROWS = 100;

interface EvidenceProps {
    data: MapData;
    metric: boolean;
    onPlace: (place: number) => void;
    onFrame: (session: string, sequence: Sequence) => void;
}

export function Evidence({ data, metric, onPlace, onFrame }: EvidenceProps) {
    const [open, setOpen] = useState(false);
    return <>
        <section class="panel closures" aria-label="Loop closures">
            <header><h2>Loop closures</h2><span class="quiet">{plural(data.closures.length, "closure")}, the least sure first</span></header>
            {data.closures.length === 0
                ? <p class="quiet">No loop was closed: no robot came back to a place that it was sure of.</p>
                : <Closures data={data} onFrame={onFrame} onPlace={onPlace} />}
        </section>
        {metric && (
            <details class="panel residuals" onToggle={(event) => setOpen(event.currentTarget.open)}>
                <summary>Links by what is left over, the worst first</summary>
                {open && <Residuals data={data} onPlace={onPlace} />}
            </details>
        )}
    </>;
}

function Closures({ data, onFrame, onPlace }: Pick<EvidenceProps, "data" | "onFrame" | "onPlace">) {
    const sorted = [...data.closures].sort((a, b) => sure(a) - sure(b));
    return (
        <div class="wide tall" tabIndex={0} role="group" aria-label="Table of loop closures"><table>
            <thead><tr><th scope="col">frame</th><th scope="col">closed with</th><th scope="col">probability</th></tr></thead>
            <tbody>
                {sorted.slice(0, MOST_ROWS).map((closure) => closure.frame && (
                    <tr key={`${closure.frame.session}/${closure.frame.sequence}`}>
                        <td><button type="button" class="link" onClick={() => onFrame(closure.frame!.session, closure.frame!.sequence)}>{short(closure.frame.session)} / {closure.frame.sequence}</button>{closure.frame.note && <span class="note"> {closure.frame.note}</span>}</td>
                        <td><PlaceLink number={closure.place_number} onPlace={onPlace} /></td>
                        <td>{closure.correction ? <span class="reason withdrawn">withdrawn</span> : share(sure(closure))}</td>
                    </tr>
                ))}
            </tbody>
        </table>{sorted.length > MOST_ROWS && <p class="quiet small">The first {MOST_ROWS}; all are in <button type="button" class="link" onClick={() => void download(`${at(data.map.name)}/loop-closures.csv`, `${short(data.map.name)}-loop-closures.csv`)}>the table</button>.</p>}</div>
    );
}

/** What is left over of each measured way, once it is wanted. */
export function useResiduals({ map }: MapData, wanted: boolean) {
    return useAsked(
        async (signal) => wanted ? residuals(await text(`${at(map.name)}/graph.g2o`, signal)) : [],
        [map.name, map.links, map.loop_closures, map.withdrawn_loop_closures, wanted],
    );
}

function Residuals({ data, onPlace }: Pick<EvidenceProps, "data" | "onPlace">) {
    const asked = useResiduals(data, true);
    return (
        <Shown asked={asked} what="the pose graph">
            {(found) => found.length === 0 ? <p class="quiet">No way was measured.</p> : (
                <div class="wide tall" tabIndex={0} role="group" aria-label="Table of links"><table>
                    <thead><tr><th scope="col">from</th><th scope="col">to</th><th scope="col">off, m</th><th scope="col">off, °</th></tr></thead>
                    <tbody>
                        {found.slice(0, MOST_ROWS).map(({ from, to, off_m, off_rad }, row) => (
                            <tr key={row}>
                                <td><PlaceLink number={from} onPlace={onPlace} /></td><td><PlaceLink number={to} onPlace={onPlace} /></td>
                                <td>{off_m.toFixed(3)}</td><td>{((off_rad * 180) / Math.PI).toFixed(2)}</td>
                            </tr>
                        ))}
                    </tbody>
                </table></div>
            )}
        </Shown>
    );
}
