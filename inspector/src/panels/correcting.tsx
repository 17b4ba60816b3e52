// What people say of the pair: it is no closure, or it is one that the map has missed. Both can be undone.
import { useState } from "preact/hooks";
import { at, change, get, type FrameRecord, type Schemas } from "../rest";
import { moment, Question, useAsked, useMay } from "../parts";

type Correction = Schemas["Correction"];
type Asked = "withdraw" | "confirm" | Correction;

interface CorrectingProps {
    record: FrameRecord;
    /** The place that the frame is shown beside: what is said is said of that one. */
    shown: number | null;
    /** The map is another one by then. */
    onCorrected: () => void;
}

export function Correcting({ record, shown, onCorrected }: CorrectingProps) {
    const may = useMay("admin");
    const [asked, setAsked] = useState<Asked | null>(null);
    const { answer, corrections } = record;
    const withdrawn = corrections.some(({ verdict }) => verdict === "withdrawn");
    const map = at(record.name).split("/").slice(0, 4).join("/");
    const place = answer?.place_number ?? null;
    const closed = answer?.reason === "loop_closure" && !withdrawn;
    const closes = closed && shown === place;
    const missed = !closed && !withdrawn && corrections.length === 0 && place !== null && shown !== null && shown !== place;
    const witness = useAsked((signal) => missed ? witnessOf(record, shown, map, signal) : Promise.resolve(null), [record, shown, missed]);
    const matched = witness.state === "there" ? witness.value : null;
    const name = short(record.name);
    const common = {
        onClose: () => setAsked(null), onDone: () => {
            setAsked(null);
            onCorrected();
        },
    };
    return <>
        {corrections.map((correction) => (
            <p key={correction.name} class="said" data-testid="correction">
                <span class={`reason ${correction.verdict}`}>{correction.verdict}</span> {told(correction, record.name)}
                {may && <> <button type="button" onClick={() => setAsked(correction)}>Undo it</button></>}
            </p>
        ))}
        {may && (closes || matched) && (
            <p class="actions">
                {closes && <button type="button" onClick={() => setAsked("withdraw")}>Not the same place</button>}
                {matched && <button type="button" onClick={() => setAsked("confirm")}>The same place</button>}
            </p>
        )}
        {may && closed && !closes && <p class="quiet small">It closed a loop with place {place}: to say that it did not, look at it beside that place.</p>}
        {asked === "withdraw" && (
            <Question
                title={`Withdraw the loop closure of frame ${name}?`} verb="Withdraw it" doing="Withdrawing"
                act={() => change<Correction>("POST", `${map}/corrections`, { withdraw: { frame: record.name } } satisfies Schemas["Correct"])} {...common}
                loss={`The robot was not at place ${answer?.place_number}: links that rest on it are taken out, and the places before and after are linked by its wheels. It can be undone.`}
            />
        )}
        {asked === "confirm" && matched && (
            <Question
                title={`Was frame ${name} at place ${shown}?`} verb="Link the places" doing="Linking them"
                act={() => change<Correction>("POST", `${map}/corrections`, { confirm: { frame: record.name, matched_frame: frameName(matched) } } satisfies Schemas["Correct"])} {...common}
                loss={`It is said to be of one place with frame ${matched.sequence} of ${short(matched.session)}. Places ${place} and ${shown} are linked. Where the map has metres, the features of both frames measure how. It can be undone.`}
            />
        )}
        {asked !== null && typeof asked === "object" && (
            <Question
                title={`Undo what was said of frame ${name}?`} verb="Undo it" doing="Undoing" {...common}
                act={() => change<Correction>("POST", `${at(asked.name)}/undo`)}
                loss="The map is as if it had not been said, with all that came since."
            />
        )}
    </>;
}

/** The frame of a place that another is said to be of one place with: the one that it was compared with, else the place's first. */
async function witnessOf({ name, answer }: FrameRecord, place: number, map: string, signal: AbortSignal): Promise<Schemas["FrameReference"] | null> {
    const compared = [answer?.match, answer?.best_candidate].find((candidate) => candidate?.place_number === place && candidate.frame);
    if (compared?.frame) return compared.frame;
    const { frames } = await get<Schemas["Place"]>(`${map}/places/${place}`, signal);
    return frames.find((frame) => frameName(frame) !== name) ?? null;
}

function frameName({ session, sequence }: Schemas["FrameReference"]): string {
    return `${session}/frames/${sequence}`;
}

function short(name: string): string {
    return name.split("/").at(-1) ?? name;
}

function told({ verdict, token, create_time_ns, frame, matched_frame }: Correction, name: string): string {
    const by = `by ${token || "somebody without a token"}, ${moment(create_time_ns)}`;
    if (verdict !== "confirmed" || !frame || !matched_frame) return by;
    const other = frameName(frame) === name ? matched_frame : frame;
    return `to be of one place with frame ${other.sequence} of ${short(other.session)} ${by}`;
}
