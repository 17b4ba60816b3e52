// How much the holder of a token may have and send, to be filled in by hand.
import { useState } from "preact/hooks";
import { at, change, short, type Schemas, type Token } from "../rest";
import { Dialog, Outcome, useAttempt } from "../parts";

type Quotas = Schemas["Quotas"];

const FIELDS = [
    { name: "max_maps", quota: "maps", words: "Most maps", least: 0, step: 1 },
    { name: "max_sessions", quota: "sessions", words: "Most sessions", least: 0, step: 1 },
    { name: "max_frames_per_second", quota: "frames_per_second", words: "Most frames a second", least: 0.01, step: "any" },
    { name: "max_kept_mib", quota: "kept", words: "Most MiB kept", least: 0, step: 1 },
] as const;

/** As it is written in the fields; what is empty is not limited. */
export type Written = Record<keyof Quotas, string>;

export const UNLIMITED: Written = { max_maps: "", max_sessions: "", max_frames_per_second: "", max_kept_mib: "" };

/** The quotas that are limited. */
export function limited(written: Written): Partial<Quotas> {
    return Object.fromEntries(FIELDS.flatMap(({ name }) => written[name] ? [[name, Number(written[name])]] : []));
}

interface QuotaFieldsProps {
    written: Written;
    onWritten: (written: Written) => void;
}

export function QuotaFields({ written, onWritten }: QuotaFieldsProps) {
    return <>{FIELDS.map(({ name, words, least, step }) => (
        <label key={name}>{words} <input class="few" type="number" min={least} step={step} value={written[name]} placeholder="any" onInput={(event) => onWritten({ ...written, [name]: event.currentTarget.value })} /></label>
    ))}</>;
}

interface LimitingProps {
    token: Token;
    onClose: () => void;
    onDone: () => void;
}

/** Changes the quotas of a token, which hold for streams that are open, too. */
export function Limiting({ token, onClose, onDone }: LimitingProps) {
    const known = Object.fromEntries(FIELDS.map(({ name }) => [name, token.quotas?.[name]?.toString() ?? ""])) as Written;
    const [written, setWritten] = useState(known);
    const { told, busy, attempt } = useAttempt();
    const limit = async () => {
        const lifted = FIELDS.filter(({ name }) => known[name] && !written[name]).map(({ quota }) => quota);
        if (await attempt("Changing them", async () => {
            await change<Token>("PATCH", at(token.name), { quotas: limited(written), lifted });
            return "changed";
        })) onDone();
    };
    return (
        <Dialog title={`Limits of ${short(token.name)}`} onClose={onClose}>
            <form onSubmit={(event) => {
                event.preventDefault();
                void limit();
            }}>
                <p>What is left empty is not limited. Streams that are open are held to it from now on.</p>
                <QuotaFields written={written} onWritten={setWritten} />
                <p class="actions"><button type="submit" class="main" disabled={busy}>Change the limits</button></p>
                <Outcome told={told} />
            </form>
        </Dialog>
    );
}
