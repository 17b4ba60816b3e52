// What the server has refused, and why: whom and with which words for those who look after it, counts for everyone.
import { all, type Schemas } from "../rest";
import { count, moment, Refused, useMayAll, usePolled } from "../parts";
import { useHour } from "./hour";

/** Codes of HTTP in words. */
const CODES: Record<string, string> = {
    400: "not understood", 401: "no token that is known", 403: "not allowed", 404: "not there", 405: "no such method",
    409: "in the way of something else", 412: "not as things are", 413: "too large", 429: "beyond a quota, or too much at once",
    500: "the server’s fault", 503: "not ready", 504: "took too long",
};

const LOG_EVERY_MS = 5000;
const MOST_REFUSALS = 200;

type Refusal = Schemas["Refusal"];

export function Refusals() {
    const may = useMayAll();
    return (
        <section class="panel" aria-label="Refused">
            <header><h2>Refused</h2></header>
            {may && <Log />}
            <Counts />
        </section>
    );
}

/** The newest, each with what was told. */
function Log() {
    const { value: refusals, error } = usePolled((signal) => all<"refusals", Refusal>("/v1/refusals", "refusals", signal, MOST_REFUSALS), () => LOG_EVERY_MS);
    if (error) return <Refused error={error} />;
    if (refusals === null) return <p class="quiet" role="status">Loading what was refused…</p>;
    if (refusals.length === 0) return <p class="quiet">Nothing was refused since the server began.</p>;
    return (
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Log of refusals"><table>
            <thead><tr><th scope="col">last</th><th scope="col">times</th><th scope="col">who</th><th scope="col">what</th><th scope="col">why</th><th scope="col">what was told</th></tr></thead>
            <tbody>{refusals.map((refusal) => (
                <tr key={`${refusal.last_time_ns} ${refusal.request} ${refusal.stream} ${refusal.message} ${refusal.peer}`}>
                    <td class="short">{moment(refusal.last_time_ns)}</td><td>{count(refusal.times)}</td><td>{who(refusal)}</td>
                    <th scope="row">{refusal.stream || refusal.request}</th><td class="short">{refusal.code.replaceAll("_", " ")}</td><td>{refusal.message}</td>
                </tr>
            ))}</tbody>
        </table></div>
    );
}

function who({ token, peer }: Refusal): string {
    const name = token.replace("tokens/", "");
    return [name, peer].filter(Boolean).join(" from ") || "unknown";
}

function Counts() {
    const { refused, error } = useHour();
    const rows = refused ? [...refused.now].map(([key, { what, why, times }]) => ({
        key, what, why: CODES[why] ? `${why}, ${CODES[why]}` : why, times, lately: times - (refused.first.get(key)?.times ?? 0),
    })) : [];
    rows.sort((a, b) => b.lately - a.lately || b.times - a.times);
    return <>
        <h3>Counts by reason</h3>
        {refused === null ? !error && <p class="quiet" role="status">Loading the counts…</p>
            : rows.length === 0 ? <p class="quiet">Nothing was refused since the server began.</p> : (
                <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of refusals"><table>
                    <thead><tr><th scope="col">what</th><th scope="col">why</th><th scope="col">while this page is open</th><th scope="col">since the server began</th></tr></thead>
                    <tbody>{rows.map(({ key, what, why, times, lately }) => (
                        <tr key={key}><th scope="row">{what}</th><td>{why}</td><td>{count(Math.max(lately, 0))}</td><td>{count(times)}</td></tr>
                    ))}</tbody>
                </table></div>
            )}
    </>;
}
