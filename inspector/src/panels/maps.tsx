// All maps: what each looks like, how large it is, where to go on.
import { useEffect, useRef, useState } from "preact/hooks";
import { ink } from "../drawing/colours";
import { load, SMALL, type MapData } from "../drawing/data";
import { paintSmall } from "../drawing/paint";
import { sceneOf } from "../drawing/scene";
import { hash, START } from "../link";
import { at, get, short, type WayMap } from "../rest";
import { bytes, moment, plural, Refused, useAsked, useDark, useMayAll, type Asked } from "../parts";
import { MapActions, NewMaps } from "./making";
import { useMaps, type Present } from "./present";

export function Maps() {
    const may = useMayAll();
    const [changes, setChanges] = useState(0);
    const changed = () => setChanges((count) => count + 1);
    const { value: listed, error } = useMaps(changes);
    return (
        <main class="maps" id="content">
            <div class="title"><h1>Maps</h1>{may && <NewMaps onChange={changed} />}</div>
            {error && <Refused error={error} />}
            {error && listed && <p class="quiet">What follows is as it was last heard of.</p>}
            {listed === null ? !error && <p class="quiet" role="status">Loading maps…</p>
                : listed.length === 0 ? <NoMaps /> : (
                    <ul class="cards">{listed.map(({ map, present }) => (
                        <MapCard key={`${map.name} ${map.create_time_ns}`} map={map} present={error ? null : present} onChange={may ? changed : null} />
                    ))}</ul>
                )}
        </main>
    );
}

function NoMaps() {
    return (
        <div class="empty">
            <p><strong>There is no map yet.</strong></p>
            <p>A map begins empty, and grows while a robot streams into it:</p>
            <pre tabIndex={0}><code>waypost map create hall{"\n"}waypost stream --map hall FOLDER-OF-IMAGES</code></pre>
            <p class="quiet">Or see it at work with <code>make demo</code>. The rest is in <a href="/docs/">the API's description</a>.</p>
        </div>
    );
}

/** Rises by one whenever a count has grown by a fifth: what takes long is asked for anew then. */
const growth = (count: number) => Math.floor(Math.log(count + 1) / Math.log(1.2));

/** A link is called by what one sees of it, too. */
const NO_PLACES = "no places yet";

interface CardProps {
    map: WayMap;
    /** `null` while the server does not say. */
    present: Present | null;
    onChange: (() => void) | null;
}

function MapCard({ map, present, onChange }: CardProps) {
    const name = short(map.name);
    const whole = useAsked((signal) => get<WayMap>(`${at(map.name)}?view=full`, signal), [map.name, growth(map.frames)]);
    const size = whole.state === "there" && whole.value.storage ? bytesOf(whole.value.storage) : null;
    const link = hash({ ...START, page: "map", map: name });
    return (
        <li class="card">
            <a class="thumbnail" href={link} aria-label={`Open the map ${name}${map.places === 0 ? `: ${NO_PLACES}` : ""}`}><Thumbnail map={map} /></a>
            <div class="card-text">
                <h2><a href={link}>{name}</a></h2>
                <p>{plural(map.places, "place")} · {plural(map.sessions, "session")} · {plural(map.frames, "frame")}</p>
                <p>{plural(map.loop_closures, "loop closure")} · {plural(map.links, "link")}{size === null ? "" : ` · ${bytes(size)}`}</p>
                <p class="quiet">{map.settings?.navigation_strategy === "appearance" ? "by appearance" : "topo-metric"} · made {moment(map.create_time_ns)}</p>
                <p data-testid="present" class={present && present.led + present.streaming > 0 ? "present" : "quiet"}>{presentText(present)}</p>
                {onChange && <MapActions map={map} onChange={onChange} />}
            </div>
        </li>
    );
}

function presentText(present: Present | null): string {
    if (!present) return "whether a robot is there is not known";
    const said = [
        ...(present.led ? [`${plural(present.led, "robot")} led now`] : []),
        ...(present.streaming ? [`${plural(present.streaming, "robot")} streaming now`] : []),
    ];
    return said.length ? said.join(", ") : "no robot there now";
}

function bytesOf(storage: NonNullable<WayMap["storage"]>): number {
    return storage.log_bytes + storage.features_bytes + storage.thumbnail_bytes + storage.image_bytes +
        storage.checkpoint_bytes;
}

function Thumbnail({ map }: { map: WayMap }) {
    const drawn = map.places > 0;
    const asked = useAsked<MapData | null>(
        async (signal) => drawn ? load(short(map.name), signal, SMALL) : null, [map.name, growth(map.places), map.loop_closures > 0],
    );
    if (!drawn) return <span class="quiet">{NO_PLACES}</span>;
    return <Drawn asked={asked} />;
}

const SIZE = { width: 296, height: 168 };

function Drawn({ asked }: { asked: Asked<MapData | null> }) {
    const canvas = useRef<HTMLCanvasElement>(null);
    const dark = useDark();
    useEffect(() => {
        const context = canvas.current?.getContext("2d");
        if (!canvas.current || !context || asked.state !== "there" || !asked.value) return;
        const sharp = devicePixelRatio || 1;
        canvas.current.width = SIZE.width * sharp;
        canvas.current.height = SIZE.height * sharp;
        context.scale(sharp, sharp);
        const scene = sceneOf(asked.value, null);
        paintSmall(context, scene, SIZE, ink(canvas.current));
    }, [asked, dark]);
    if (asked.state === "refused") return <span class="quiet">{asked.error.message}</span>;
    return <canvas ref={canvas} aria-hidden="true" />;
}
