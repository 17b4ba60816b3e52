// The servers of the database, and how they and it do; for those who look after all of it.
import { get, type Schemas } from "../rest";
import { bytes, count, fixed, plural, Refused, usePolled } from "../parts";

const EVERY_MS = 5000;

type Cluster = Schemas["Cluster"];

export function Servers() {
    const { value: cluster, error } = usePolled((signal) => get<Cluster>("/v1/cluster", signal), () => EVERY_MS);
    return (
        <section class="panel" aria-label="Servers">
            <header><h2>Servers</h2>{cluster && <p class="quiet small">{owned(cluster)}</p>}</header>
            {error && <Refused error={error} />}
            {cluster === null ? !error && <p class="quiet" role="status">Loading servers…</p> : <>
                <Table cluster={cluster} />
                {cluster.standbys.length > 0 && <Standbys standbys={cluster.standbys} />}
                {cluster.warnings.map((warning) => <p key={warning} class="refused" role="status">{warning}</p>)}
            </>}
        </section>
    );
}

function owned({ database, epoch, load }: Cluster): string {
    const kept = database === "postgres" ? `PostgreSQL, epoch ${epoch}` : "SQLite, which has one server";
    const waits = load ? `. Waiting: ${plural(load.images_waiting, "image")}, ${plural(load.requests_waiting, "request")}` : "";
    return `${kept}${waits}`;
}

function Table({ cluster: { servers } }: { cluster: Cluster }) {
    return (
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of servers"><table>
            <thead><tr><th scope="col">server</th><th scope="col">role</th><th scope="col">version</th><th scope="col">cores</th><th scope="col">images looked at</th><th scope="col">for robots</th><th scope="col">for people</th><th scope="col">last heard of</th></tr></thead>
            <tbody>{servers.map((server) => (
                <tr key={`${server.holder} ${server.http_address}`}>
                    <th scope="row">{server.holder}</th><td>{server.role}</td><td>{server.version || "unknown"}</td><td>{count(server.cores)}</td>
                    <td>{server.images === null ? "not asked" : count(server.images)}</td>
                    <td class="short">{server.grpc_address}</td><td class="short">{server.http_address}</td>
                    <td class="short">{server.silent_s < 2 ? "just now" : `${fixed(server.silent_s, 0)} s ago`}</td>
                </tr>
            ))}</tbody>
        </table></div>
    );
}

function Standbys({ standbys }: { standbys: Cluster["standbys"] }) {
    return <>
        <h3>Standbys of PostgreSQL</h3>
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of standbys"><table>
            <thead><tr><th scope="col">standby</th><th scope="col">state</th><th scope="col">waited for</th><th scope="col">lacks</th></tr></thead>
            <tbody>{standbys.map(({ name, state, sync_state, lag_bytes }, index) => (
                <tr key={index}>
                    <th scope="row">{name}</th><td>{state}</td><td>{sync_state}</td><td>{lag_bytes === null ? "unknown" : bytes(lag_bytes)}</td>
                </tr>
            ))}</tbody>
        </table></div>
    </>;
}
