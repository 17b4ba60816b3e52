// What the colours of places and ways mean.
import { named } from "../drawing/colours";
import type { MapData } from "../drawing/data";
import type { Scene } from "../drawing/scene";
import type { Colour } from "../link";
import { short } from "../rest";

/** More than so many colours are hard to tell apart, and come again. */
const MOST_KEYS = 8;

interface ColourKeysProps {
    colour: Colour;
    data: MapData;
    scene: Scene;
}

export function ColourKeys({ colour, data, scene }: ColourKeysProps) {
    if (colour === "time") return <span data-testid="colours">first place <span class="ramp along" /> last</span>;
    const keys = colour === "session"
        ? data.sessions.map(({ name }, at) => [at, short(name)] as const)
        : [...new Set(scene.spaceOf)].sort((a, b) => a - b).map((at) => [at, `${scene.kind === "metric" ? "part" : "space"} ${at}`] as const);
    return (
        <span class="colours" data-testid="colours">
            {keys.slice(0, MOST_KEYS).map(([at, words]) => <span key={at}><span class="swatch" style={{ background: named(at) }} />{words}</span>)}
            {keys.length > MOST_KEYS && <span>and {keys.length - MOST_KEYS} more: colours come again</span>}
        </span>
    );
}
