// A place: what it looked like, who was there, where its links lead, and its label, which can be changed.
import { useContext, useEffect, useState } from "preact/hooks";
import type { MapData } from "../drawing/data";
import { pose } from "../drawing/geometry";
import { at, change, get, short, type Place as PlaceRecord, type Schemas } from "../rest";
import { brief, type Sequence } from "../sequence";
import { fixed, keepsPictures, moment, NoPicture, Picture, plural, Refused, Renewals, Shown, useAsked, useMay } from "../parts";
import { PlaceLink } from "./pair";

const MOST_FRAMES = 24;

interface PlaceProps {
    data: MapData;
    /** Whether the map is another by now: its labels are those of places that had the numbers before. */
    stale: boolean;
    number: number;
    onPlace: (place: number) => void;
    onFrame: (session: string, sequence: Sequence) => void;
    onLabels: (labels: Map<number, string>) => void;
}

export function Place({ data, stale, number, onPlace, onFrame, onLabels }: PlaceProps) {
    const name = `${data.map.name}/places/${number}`;
    const asked = useAsked((signal) => get<PlaceRecord>(at(name), signal), [name]);
    const renewals = useContext(Renewals);
    const mayLabel = useMay("navigate");
    return (
        <section class="panel place" aria-label="The place">
            <header><h2>Place {number}</h2></header>
            <Shown asked={asked} what="the place">
                {(place) => <About place={place} pictures={keepsPictures(data.map)} onPlace={onPlace} onFrame={onFrame} />}
            </Shown>
            {mayLabel && !stale && <Label key={`${name} ${renewals}`} data={data} number={number} onLabels={onLabels} />}
        </section>
    );
}

type AboutProps = { place: PlaceRecord; pictures: boolean } & Pick<PlaceProps, "onPlace" | "onFrame">;

function About({ place, pictures, onPlace, onFrame }: AboutProps) {
    const where = pose(place.pose?.pose);
    const several = new Set(place.frames.map(({ session }) => session)).size > 1;
    return <>
        <div class="looks">
            {place.frames.slice(0, MOST_FRAMES).map(({ session, sequence, stamp_ns }) => (
                <button
                    key={`${session}/${sequence}`} type="button" class="frame" onClick={() => onFrame(session, sequence)}
                    aria-label={`Frame ${sequence} of ${short(session)}`} title={`${short(session)}, frame ${sequence}, ${moment(stamp_ns)}`}
                >
                    {pictures ? <Picture path={`${at(session)}/frames/${sequence}/image?size=thumbnail`} alt="" /> : <NoPicture />}
                    <span>{several && `${short(session)} `}{brief(sequence)}</span>
                </button>
            ))}
        </div>
        {place.frames.length > MOST_FRAMES && <p class="quiet small">The first {MOST_FRAMES} of {plural(place.frames.length, "frame")}.</p>}
        <dl class="facts">
            <div><dt>learnt from</dt><dd>{plural(place.looks, "look")}, {plural(place.words, "word")}</dd></div>
            {where && <div><dt>x, y</dt><dd>{fixed(where.x, 2)}, {fixed(where.y, 2)} m</dd></div>}
            {where && <div><dt>heading</dt><dd>{fixed((where.heading * 180) / Math.PI, 0)}°</dd></div>}
            <div>
                <dt>links</dt>
                <dd class="links">{place.linked_place_numbers.length === 0 ? "none" : place.linked_place_numbers.map((linked) => <PlaceLink key={linked} number={linked} onPlace={onPlace} />)}</dd>
            </div>
        </dl>
    </>;
}

function Label({ data, number, onLabels }: Pick<PlaceProps, "data" | "number" | "onLabels">) {
    const label = data.labels.get(number) ?? "";
    const [written, setWritten] = useState(label);
    const [scope, setScope] = useState<Schemas["LabelScope"]>("place");
    const [told, setTold] = useState<Error | "busy" | "saved" | "removed" | null>(null);
    useEffect(() => setWritten(label), [label]);
    const path = `${at(`${data.map.name}/places/${number}`)}/label`;
    const attempt = async (act: () => Promise<"saved" | "removed">) => {
        setTold("busy");
        await act().then(setTold, (error: Error) => setTold(error));
    };
    const save = () => attempt(async () => {
        const { labels } = await change<Schemas["SetLabelResponse"]>("PUT", path, { label: written, scope });
        const next = new Map(data.labels);
        for (const { place, label } of labels) next.set(Number(short(place)), label);
        onLabels(next);
        return "saved";
    });
    const remove = () => attempt(async () => {
        await change("DELETE", path);
        const next = new Map(data.labels);
        next.delete(number);
        onLabels(next);
        return "removed";
    });
    return (
        <form class="label" onSubmit={(event) => {
            event.preventDefault();
            void save();
        }}>
            <label>Label <input name="label" value={written} autoComplete="off" placeholder="none" onInput={(event) => setWritten(event.currentTarget.value)} /></label>
            {data.graph && (
                <label>For <select value={scope} onChange={(event) => setScope(event.currentTarget.value as Schemas["LabelScope"])}>
                    <option value="place">this place</option><option value="space">all of its space</option>
                </select></label>
            )}
            <button type="submit" disabled={told === "busy" || !written || (written === label && scope === "place")}>Save</button>
            <button type="button" disabled={told === "busy" || !label} onClick={() => void remove()}>Remove</button>
            {told instanceof Error ? <Refused error={told} /> : <span role="status" class="quiet">{told === "saved" || told === "removed" ? told : ""}</span>}
        </form>
    );
}
