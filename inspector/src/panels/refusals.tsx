// What the server has refused, and why: counts of its metrics, for it keeps no list of refusals.
import { count } from "../parts";
import { useHour } from "./hour";

/** Codes of HTTP in words. */
const CODES: Record<string, string> = {
    400: "not understood", 401: "no token that is known", 403: "not allowed", 404: "not there", 405: "no such method",
    409: "in the way of something else", 412: "not as things are", 413: "too large", 429: "beyond a quota, or too much at once",
    500: "the server’s fault", 503: "not ready", 504: "took too long",
};

export function Refusals() {
    const { refused, error } = useHour();
    const rows = refused ? [...refused.now].map(([key, { what, why, times }]) => ({
        key, what, why: CODES[why] ? `${why}, ${CODES[why]}` : why, times, lately: times - (refused.first.get(key)?.times ?? 0),
    })) : [];
    rows.sort((a, b) => b.lately - a.lately || b.times - a.times);
    return (
        <section class="panel" aria-label="Refused">
            <header><h2>Refused</h2><p class="quiet small">Counts by reason. Who was refused, when and with which words is in the server’s own log alone.</p></header>
            {refused === null ? !error && <p class="quiet" role="status">Loading what was refused…</p>
                : rows.length === 0 ? <p class="quiet">Nothing was refused since the server began.</p> : (
                    <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of refusals"><table>
                        <thead><tr><th scope="col">what</th><th scope="col">why</th><th scope="col">while this page is open</th><th scope="col">since the server began</th></tr></thead>
                        <tbody>{rows.map(({ key, what, why, times, lately }) => (
                            <tr key={key}><th scope="row">{what}</th><td>{why}</td><td>{count(Math.max(lately, 0))}</td><td>{count(times)}</td></tr>
                        ))}</tbody>
                    </table></div>
                )}
        </section>
    );
}
