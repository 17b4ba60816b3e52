// Why a frame was decided as it was: it beside what it was compared with, and each gate with its number.
import { at, get, type Explanation, type FrameRecord, type Schemas } from "../rest";
import type { Sequence } from "../sequence";
import { pause, Picture, share, Shown, useAsked } from "../parts";
import { Correcting } from "./correcting";
import { Large } from "./large";
import { REASONS, type Step } from "./steps";

/** An explanation is a replay, so it is asked for where the cursor rests. */
const REST_MS = 120;
/** A cursor that goes with a robot rests only where the robot does. */
const FOLLOWING_REST_MS = 800;

interface PairProps {
    session: string;
    step: Step;
    /** The place that it is shown beside; without it, the one that it was compared with. */
    beside: number | null;
    /** Whether the map keeps any of its frames. */
    pictures: boolean;
    large: boolean;
    follow: boolean;
    onLarge: (large: boolean) => void;
    onPlace: (place: number) => void;
    onCorrected: () => void;
}

export function Pair({ session, step, beside, pictures, large, follow, onLarge, onPlace, onCorrected }: PairProps) {
    const frame = `${at(session)}/frames/${step.sequence}`;
    const place = beside === null ? "" : `?place_number=${beside}`;
    const asked = useAsked(async (signal) => {
        await pause(follow ? FOLLOWING_REST_MS : REST_MS, signal);
        return Promise.all([get<Explanation>(`${frame}/explanation${place}`, signal), get<FrameRecord>(frame, signal)]);
    }, [frame, place]);
    return (
        <section class="panel pair" aria-label="The pair">
            <header><h2>Frame {step.sequence}</h2>{beside !== null && <span class="quiet">beside place {beside}</span>}{step.note && <span class="note" data-testid="note">{step.note}</span>}<span class={`reason ${step.reason}`}>{REASONS[step.reason] ?? step.reason}</span></header>
            <Shown asked={asked} what="why it was decided so">
                {([explanation, record]) => <>
                    {(pictures || explanation.picture !== null) && <Views explanation={explanation} frame={frame} sequence={step.sequence} large={large} onLarge={onLarge} />}
                    <Correcting record={record} shown={explanation.place_explanation?.place_number ?? null} onCorrected={onCorrected} />
                    <Facts record={record} explanation={explanation} onPlace={onPlace} />
                    {explanation.gates.length > 0 && <Gates gates={explanation.gates} />}
                    {explanation.place_explanation && <Words explained={explanation.place_explanation} />}
                </>}
            </Shown>
        </section>
    );
}

interface ViewsProps {
    explanation: Explanation;
    frame: string;
    sequence: Sequence;
    large: boolean;
    onLarge: (large: boolean) => void;
}

function Views({ explanation, frame, sequence, large, onLarge }: ViewsProps) {
    const place = explanation.place_explanation?.place_number;
    const path = explanation.picture ?? null;
    const alt = path ? `Frame ${sequence} beside the frame of place ${place} that it was compared with` : `Frame ${sequence}`;
    const source = path ?? `${frame}/image`;
    return <>
        <button type="button" class="enlarge" onClick={() => onLarge(true)} aria-label={`Enlarge: ${alt}`}>
            <Picture path={source} alt={alt} />
        </button>
        {path && <p class="quiet small">Green: a word in common, or joined by geometry. Red: neither. Squares: expected here, and not seen.</p>}
        {large && <Large path={source} alt={alt} as="fitted" onClose={() => onLarge(false)} />}
    </>;
}

interface FactsProps {
    record: FrameRecord;
    explanation: Explanation;
    onPlace: (place: number) => void;
}

function Facts({ record, explanation, onPlace }: FactsProps) {
    const { answer } = record;
    if (!answer) return <p class="quiet">The server keeps no answer of this frame.</p>;
    const compared = answer.match ?? answer.best_candidate ?? null;
    const geometry = compared?.geometry ?? null;
    const shown = explanation.place_explanation?.place_number ?? null;
    const [likely] = answer.places;
    const movedOn = answer.reason === "new_place" && likely !== undefined && likely.posterior > answer.new_place_posterior && record.odometry;
    return <>
        <dl class="facts">
            <Fact name="decided">{answer.place_number === null || answer.place_number === undefined ? "no place" : <PlaceLink number={answer.place_number} onPlace={onPlace} />}</Fact>
            {shown !== null && shown !== answer.place_number && <Fact name="shown beside"><PlaceLink number={shown} onPlace={onPlace} /></Fact>}
            {likely && <Fact name="most probable, by words"><PlaceLink number={likely.place_number} onPlace={onPlace} />, {share(likely.posterior)}</Fact>}
            <Fact name="somewhere new, by words">{share(answer.new_place_posterior)}</Fact>
            <Fact name="words">{answer.words}</Fact>
            {compared && <Fact name={answer.match ? "matched" : "best for a loop"}><PlaceLink number={compared.place_number} onPlace={onPlace} /></Fact>}
            {geometry && <Fact name="… features that agree">{geometry.inliers} of {geometry.matches}</Fact>}
            {geometry && <Fact name="… probability of that pair">{share(geometry.probability)}</Fact>}
            {!explanation.reproduced && <Fact name="replay">came to other numbers than were logged: another build decided it, or the map was rewritten since, as by a merge. The logged ones hold.</Fact>}
        </dl>
        {movedOn && <p class="quiet small">By words the robot was at place {likely.place_number}. Its wheels say that it had moved or turned by more than a place reaches, so this is a place of its own.</p>}
    </>;
}

function Fact({ name, children }: { name: string; children: preact.ComponentChildren }) {
    return <div><dt>{name}</dt><dd>{children}</dd></div>;
}

export function PlaceLink({ number, onPlace }: { number: number; onPlace: (place: number) => void }) {
    return <button type="button" class="link" onClick={() => onPlace(number)}>place {number}</button>;
}

function Gates({ gates }: { gates: Schemas["Gate"][] }) {
    return <>
        <h3>Gates</h3>
        <ul class="gates">
            {gates.map(({ name, passed, description }) => (
                <li key={name} class={passed ? "passed" : "failed"}>
                    <span class="verdict">{passed ? "✓ passed" : "✕ not passed"}</span> <strong>{name.replaceAll("_", " ")}</strong>
                    <p>{description}</p>
                </li>
            ))}
        </ul>
    </>;
}

const MOST_WORDS = 6;

function Words({ explained }: { explained: Schemas["PlaceExplanation"] }) {
    const { words_for, words_against, place_number } = explained;
    const shown = [...words_for.slice(0, MOST_WORDS), ...words_against.slice(0, MOST_WORDS)];
    const most = Math.max(...shown.map(({ evidence_nats }) => Math.abs(evidence_nats)), 1e-9);
    return <>
        <h3>Words that speak for or against place {place_number}</h3>
        <table class="words">
            <thead><tr><th scope="col">word</th><th scope="col">here</th><th scope="col">there</th><th scope="col">evidence, nats</th></tr></thead>
            <tbody>
                {shown.map(({ word, seen, hits, looks, evidence_nats }) => (
                    <tr key={word} class={evidence_nats < 0 ? "against" : "for"}>
                        <th scope="row">{word}</th><td>{seen ? "seen" : evidence_nats < 0 ? "expected, not seen" : "not seen"}</td><td>{hits} of {looks}</td>
                        <td><meter aria-label={`evidence of word ${word}`} min={0} max={most} value={Math.abs(evidence_nats)} /> {evidence_nats.toFixed(2)}</td>
                    </tr>
                ))}
            </tbody>
        </table>
    </>;
}
