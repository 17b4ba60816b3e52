// Who may use the server: tokens, made and deleted. A secret is shown once, for the server does not keep it.
import { useContext, useState } from "preact/hooks";
import { all, at, change, createToken, short, type Token } from "../rest";
import { Deletion, moment, Outcome, Shown, useAsked, useAttempt, Who } from "../parts";

export function Tokens({ onTokens }: { onTokens: () => void }) {
    const [changes, setChanges] = useState(0);
    const [leaving, setLeaving] = useState<Token | null>(null);
    const own = useContext(Who)?.token;
    const asked = useAsked((signal) => all<"tokens", Token>("/v1/tokens", "tokens", signal), [changes]);
    const known = asked.state === "there" ? asked.value : asked.state === "asking" ? asked.before : undefined;
    const changed = () => {
        setChanges((count) => count + 1);
        onTokens();
    };
    return (
        <section class="panel" aria-label="Tokens">
            <header><h2>Tokens</h2></header>
            <Shown asked={asked} what="tokens">
                {(tokens) => tokens.length === 0
                    ? <p class="quiet">There is none, so the server serves whoever reaches it. The first has to be an admin’s; from then on everyone needs one.</p>
                    : <List tokens={tokens} own={own} onDelete={setLeaving} />}
            </Shown>
            {/* Beside the list, which is drawn anew: the secret stays. */}
            {known && <Making first={known.length === 0} onMade={changed} />}
            {leaving && (
                <Deletion
                    what="the token" name={short(leaving.name)} act={() => change("DELETE", at(leaving.name))}
                    loss={`Whoever holds it is refused from then on, and what was begun with it ends.${leaving.name === own ? " It is the one that this page uses." : ""}`}
                    onClose={() => setLeaving(null)} onDone={() => {
                        setLeaving(null);
                        changed();
                    }}
                />
            )}
        </section>
    );
}

function List({ tokens, own, onDelete }: { tokens: Token[]; own: string | undefined; onDelete: (token: Token) => void }) {
    return (
        <div class="wide" tabIndex={0} role="group" aria-label="Table of tokens"><table>
            <thead><tr><th scope="col">token</th><th scope="col">role</th><th scope="col">since</th><th scope="col">limited to</th><th scope="col"><span class="unseen">what to do</span></th></tr></thead>
            <tbody>
                {tokens.map((token) => (
                    <tr key={token.name}>
                        <th scope="row">{short(token.name)}{token.name === own && <span class="quiet"> (this page’s)</span>}</th>
                        <td><span class={`reason ${token.role}`}>{token.role}</span></td><td>{moment(token.create_time_ns)}</td>
                        <td>{limits(token).join("; ") || <span class="quiet">nothing</span>}</td>
                        <td class="do"><button type="button" aria-label={`Delete the token ${short(token.name)}`} onClick={() => onDelete(token)}>Delete</button></td>
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

function Making({ first, onMade }: { first: boolean; onMade: () => void }) {
    const [name, setName] = useState("");
    const [role, setRole] = useState<Token["role"]>(first ? "admin" : "robot");
    const [secret, setSecret] = useState<{ name: string; secret: string } | null>(null);
    const { told, busy, attempt } = useAttempt();
    const make = async () => {
        setSecret(null);
        if (await attempt("Making it", async () => {
            const made = await createToken(name, role);
            setSecret({ name, secret: made.secret });
            return "made";
        })) {
            setName("");
            setRole("robot");
            onMade();
        }
    };
    return <>
        <form class="making" onSubmit={(event) => {
            event.preventDefault();
            void make();
        }}>
            <label>Name of a new token <input value={name} required autoComplete="off" spellcheck={false} placeholder={first ? "operator" : "robot-7"} onInput={(event) => setName(event.currentTarget.value)} /></label>
            <label>Role <select value={role} onChange={(event) => setRole(event.currentTarget.value as Token["role"])}>
                <option value="reader" disabled={first}>reader: read</option><option value="robot" disabled={first}>robot: stream, query, read</option><option value="admin">admin: everything</option>
            </select></label>
            <button type="submit" disabled={busy || !name}>Make a token</button>
        </form>
        {secret ? <Secret key={secret.secret} {...secret} /> : <Outcome told={told} />}
    </>;
}

function Secret({ name, secret }: { name: string; secret: string }) {
    const [copied, setCopied] = useState<string | null>(null);
    const copy = () => navigator.clipboard.writeText(secret).then(() => setCopied("copied"), () => setCopied("not copied: mark it and copy it by hand"));
    return (
        <div class="secret" role="status">
            <p><strong>The secret of {name}.</strong> Note it now: it is shown this once, and the server does not keep it.</p>
            <p class="actions"><code>{secret}</code> {navigator.clipboard && <button type="button" onClick={() => void copy()}>Copy</button>} <span class="quiet">{copied}</span></p>
        </div>
    );
}
