// Who may use the server: tokens, made, limited, given new secrets and deleted. A secret is shown once, for the server
// does not keep it.
import { useContext, useState } from "preact/hooks";
import { all, at, change, createToken, rotateToken, short, type Schemas, type Token } from "../rest";
import { Deletion, Dialog, moment, Outcome, Shown, useAsked, useAttempt, Who } from "../parts";
import { limited, Limiting, QuotaFields, UNLIMITED } from "./quotas";

interface NewSecret {
    name: string;
    secret: string;
}

/** What is done with a token that is there. */
type Doing = { token: Token; what: "delete" | "limit" | "rotate" };

export function Tokens({ onTokens }: { onTokens: () => void }) {
    const [changes, setChanges] = useState(0);
    const [doing, setDoing] = useState<Doing | null>(null);
    const [secret, setSecret] = useState<NewSecret | null>(null);
    const own = useContext(Who)?.token;
    const asked = useAsked((signal) => all<"tokens", Token>("/v1/tokens", "tokens", signal), [changes]);
    const known = asked.state === "there" ? asked.value : asked.state === "asking" ? asked.before : undefined;
    const close = () => setDoing(null);
    const changed = () => {
        close();
        setChanges((count) => count + 1);
        onTokens();
    };
    return (
        <section class="panel" aria-label="Tokens">
            <header><h2>Tokens</h2></header>
            <Shown asked={asked} what="tokens">
                {(tokens) => tokens.length === 0
                    ? <p class="quiet">There is none, so the server serves whoever reaches it. The first has to be an admin’s; from then on everyone needs one.</p>
                    : <List tokens={tokens} own={own} onDo={setDoing} />}
            </Shown>
            {/* Beside the list, which is drawn anew: the secret stays. */}
            {secret && <Secret key={secret.secret} {...secret} />}
            {known && <Making first={known.length === 0} onBegin={() => setSecret(null)} onMade={(made) => {
                setSecret(made);
                changed();
            }} />}
            {doing?.what === "delete" && (
                <Deletion
                    what="the token" name={short(doing.token.name)} act={() => change("DELETE", at(doing.token.name))}
                    loss={`Whoever holds it is refused from then on, and what was begun with it ends.${doing.token.name === own ? " It is the one that this page uses." : ""}`}
                    onClose={close} onDone={changed}
                />
            )}
            {doing?.what === "limit" && <Limiting token={doing.token} onClose={close} onDone={changed} />}
            {doing?.what === "rotate" && <Rotating token={doing.token} own={doing.token.name === own} onClose={close} onDone={(rotated) => {
                setSecret(rotated);
                changed();
            }} />}
        </section>
    );
}

function List({ tokens, own, onDo }: { tokens: Token[]; own: string | undefined; onDo: (doing: Doing) => void }) {
    return (
        <div class="wide" tabIndex={0} role="group" aria-label="Table of tokens"><table>
            <thead><tr><th scope="col">token</th><th scope="col">role</th><th scope="col">since</th><th scope="col">limited to</th><th scope="col"><span class="unseen">what to do</span></th></tr></thead>
            <tbody>
                {tokens.map((token) => (
                    <tr key={token.name}>
                        <th scope="row">{short(token.name)}{token.name === own && <span class="quiet"> (this page’s)</span>}</th>
                        <td><span class={`reason ${token.role}`}>{token.role}</span></td><td>{moment(token.create_time_ns)}</td>
                        <td>{limits(token).join("; ") || <span class="quiet">nothing</span>}</td>
                        <td class="do">
                            <button type="button" aria-label={`Limits of the token ${short(token.name)}`} onClick={() => onDo({ token, what: "limit" })}>Limits</button>
                            <button type="button" aria-label={`New secret for the token ${short(token.name)}`} onClick={() => onDo({ token, what: "rotate" })}>New secret</button>
                            <button type="button" aria-label={`Delete the token ${short(token.name)}`} onClick={() => onDo({ token, what: "delete" })}>Delete</button>
                        </td>
                    </tr>
                ))}
            </tbody>
        </table></div>
    );
}

const MIB = 1024 * 1024;

/** What a token is limited to, and how much of that there is. */
function limits({ role, abilities, maps, quotas, used, expire_time_ns }: Token): string[] {
    const most = (max: number | null | undefined, has: number | undefined, what: string) => max == null ? [] : [`${has ?? 0} of ${max} ${what}`];
    return [
        ...(maps.length > 0 ? [`the maps ${maps.join(", ")}`] : []),
        ...(role === "robot" && abilities.length < 4 ? [`may ${abilities.join(", ")}`] : []),
        ...most(quotas?.max_maps, used?.maps, "maps"),
        ...most(quotas?.max_sessions, used?.sessions, "sessions"),
        ...(quotas?.max_frames_per_second == null ? [] : [`${quotas.max_frames_per_second} frames a second`]),
        ...most(quotas?.max_kept_mib, Math.round((used?.kept_bytes ?? 0) / MIB), "MiB kept"),
        ...(expire_time_ns == null ? [] : [`until ${moment(expire_time_ns)}`]),
    ];
}

type Ability = Token["abilities"][number];

const ABILITIES: readonly Ability[] = ["read", "localize", "stream", "navigate"];
const DAY_S = 24 * 60 * 60;
const HOUR_S = 60 * 60;

interface MakingProps {
    first: boolean;
    onBegin: () => void;
    onMade: (made: NewSecret) => void;
}

function Making({ first, onBegin, onMade }: MakingProps) {
    const [name, setName] = useState("");
    const [role, setRole] = useState<Token["role"]>(first ? "admin" : "robot");
    const [maps, setMaps] = useState("");
    const [abilities, setAbilities] = useState<readonly Ability[]>(ABILITIES);
    const [days, setDays] = useState("");
    const [quotas, setQuotas] = useState(UNLIMITED);
    const { told, busy, attempt } = useAttempt();
    const request = (): Schemas["CreateToken"] => ({
        token_id: name, role, maps: maps.split(/[\s,]+/).filter(Boolean),
        abilities: role === "robot" && abilities.length < ABILITIES.length ? [...abilities] : [],
        lifetime_s: days ? Math.round(Number(days) * DAY_S) : null, quotas: limited(quotas),
    });
    const make = async () => {
        onBegin();
        if (await attempt("Making it", async () => {
            const made = await createToken(request());
            onMade({ name, secret: made.secret });
            return "";
        })) {
            setName("");
            setRole("robot");
            setMaps("");
            setAbilities(ABILITIES);
            setDays("");
            setQuotas(UNLIMITED);
        }
    };
    const toggled = (ability: Ability, on: boolean) => ABILITIES.filter((known) => known === ability ? on : abilities.includes(known));
    return <>
        <form onSubmit={(event) => {
            event.preventDefault();
            void make();
        }}>
            <div class="making">
                <label>Name of a new token <input value={name} required autoComplete="off" spellcheck={false} placeholder={first ? "operator" : "robot-7"} onInput={(event) => setName(event.currentTarget.value)} /></label>
                <label>Role <select value={role} onChange={(event) => setRole(event.currentTarget.value as Token["role"])}>
                    <option value="reader" disabled={first}>reader: read</option><option value="robot" disabled={first}>robot: stream, query, read</option><option value="admin">admin: everything</option>
                </select></label>
                <button type="submit" disabled={busy || !name || (role === "robot" && abilities.length === 0)}>Make a token</button>
            </div>
            {!first && <details>
                <summary>Limit it</summary>
                <div class="making">
                    <label>Maps that it reaches <input value={maps} autoComplete="off" spellcheck={false} placeholder="all, or hall, floor2-*" onInput={(event) => setMaps(event.currentTarget.value)} /></label>
                    <label>Days that it is good for <input class="few" type="number" min={0.01} step="any" value={days} placeholder="any" onInput={(event) => setDays(event.currentTarget.value)} /></label>
                    {role === "robot" && ABILITIES.map((ability) => (
                        <label key={ability} class="choice"><input type="checkbox" checked={abilities.includes(ability)} onChange={(event) => setAbilities(toggled(ability, event.currentTarget.checked))} /> <span>may {ability}</span></label>
                    ))}
                    <QuotaFields written={quotas} onWritten={setQuotas} />
                </div>
            </details>}
        </form>
        <Outcome told={told} />
    </>;
}

interface RotatingProps {
    token: Token;
    own: boolean;
    onClose: () => void;
    onDone: (rotated: NewSecret) => void;
}

/** Gives a token a new secret. Robots have as long as the one before stays good to be given the new one. */
function Rotating({ token, own, onClose, onDone }: RotatingProps) {
    const [hours, setHours] = useState("1");
    const { told, busy, attempt } = useAttempt();
    const rotate = () => attempt("Making it", async () => {
        const { secret } = await rotateToken(token, Math.round(Number(hours) * HOUR_S), own);
        onDone({ name: short(token.name), secret });
        return "";
    });
    return (
        <Dialog title={`A new secret for ${short(token.name)}`} onClose={onClose}>
            <form onSubmit={(event) => {
                event.preventDefault();
                void rotate();
            }}>
                <p>What was begun with the secret before goes on until that ends. With 0 hours, it ends at once.{own && " This page goes on with the new one."}</p>
                <label>Hours that the one before stays good <input type="number" min={0} max={168} step="any" required value={hours} onInput={(event) => setHours(event.currentTarget.value)} /></label>
                <p class="actions"><button type="submit" class="main" disabled={busy}>Make a new secret</button></p>
                <Outcome told={told} />
            </form>
        </Dialog>
    );
}

function Secret({ name, secret }: NewSecret) {
    const [copied, setCopied] = useState<string | null>(null);
    const copy = () => navigator.clipboard.writeText(secret).then(() => setCopied("copied"), () => setCopied("not copied: mark it and copy it by hand"));
    return (
        <div class="secret" role="status">
            <p><strong>The secret of {name}.</strong> Note it now: it is shown this once, and the server does not keep it.</p>
            <p class="actions"><code>{secret}</code> {navigator.clipboard && <button type="button" onClick={() => void copy()}>Copy</button>} <span class="quiet">{copied}</span></p>
        </div>
    );
}
