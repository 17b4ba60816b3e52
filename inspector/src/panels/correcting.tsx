// What people say of the pair: it is no closure, or it is one that the map has missed. Both can be undone.
import { useState } from "preact/hooks";
import { at, change, type FrameRecord, type Schemas } from "../rest";
import { forgetPictures, moment, Question, useMay } from "../parts";

type Correction = Schemas["Correction"];
type Asked = "withdraw" | "confirm" | Correction;

interface CorrectingProps {
    record: FrameRecord;
    /** The map is another one by then. */
    onCorrected: () => void;
}

export function Correcting({ record, onCorrected }: CorrectingProps) {
    const may = useMay("admin");
    const [asked, setAsked] = useState<Asked | null>(null);
    const { answer, corrections } = record;
    const withdrawn = corrections.some(({ verdict }) => verdict === "withdrawn");
    const closes = answer?.reason === "loop_closure" && !withdrawn;
    const candidate = answer?.match ?? answer?.best_candidate ?? null;
    const missed = !closes && !withdrawn && corrections.length === 0 && typeof answer?.place_number === "number"
        && candidate?.frame && candidate.place_number !== answer.place_number;
    const map = at(record.name).split("/").slice(0, 4).join("/");
    const name = short(record.name);
    const common = {
        onClose: () => setAsked(null), onDone: () => {
            setAsked(null);
            // It is written into the picture, too.
            forgetPictures();
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
        {may && (closes || missed) && (
            <p class="actions">
                {closes && <button type="button" onClick={() => setAsked("withdraw")}>Not the same place</button>}
                {missed && <button type="button" onClick={() => setAsked("confirm")}>The same place</button>}
            </p>
        )}
        {asked === "withdraw" && (
            <Question
                title={`Withdraw the loop closure of frame ${name}?`} verb="Withdraw it" doing="Withdrawing"
                act={() => change<Correction>("POST", `${map}/corrections`, { withdraw: { frame: record.name } } satisfies Schemas["Correct"])} {...common}
                loss={`The robot was not at place ${answer?.place_number}: links that rest on it are taken out, and the places before and after are linked by its wheels. It can be undone.`}
            />
        )}
        {asked === "confirm" && candidate?.frame && (
            <Question
                title={`Was frame ${name} at place ${candidate.place_number}?`} verb="Link the places" doing="Linking them"
                act={() => change<Correction>("POST", `${map}/corrections`, { confirm: { frame: record.name, matched_frame: frameName(candidate.frame!) } } satisfies Schemas["Correct"])} {...common}
                loss={`Places ${answer?.place_number} and ${candidate.place_number} are linked. Where the map has metres, the features of both frames measure how. It can be undone.`}
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
