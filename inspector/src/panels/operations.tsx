// What the server works with and on: how it fares, its jobs, models and tokens.
import { useState } from "preact/hooks";
import { all, at, change, download, send, short, type Job, type Model } from "../rest";
import { bytes, count, Deletion, Dialog, moment, Outcome, Refused, Shown, useAsked, useAttempt, useMayAll, usePolled } from "../parts";
import { Metrics } from "./metrics";
import { Refusals } from "./refusals";
import { Servers } from "./servers";
import { Tokens } from "./tokens";

export function Operations({ onTokens }: { onTokens: () => void }) {
    const may = useMayAll();
    return (
        <main class="operations" id="content">
            <h1>Operations</h1>
            <Metrics />
            {may && <Servers />}
            <Refusals />
            <Jobs />
            <Models />
            {may && <Tokens onTokens={onTokens} />}
        </main>
    );
}

/** Jobs are asked for again while the page is looked at. */
const JOBS_EVERY_MS = 2000;
const MOST_JOBS = 200;

function Jobs() {
    const { value: jobs, error, again } = usePolled((signal) => all<"jobs", Job>("/v1/jobs", "jobs", signal, MOST_JOBS), () => JOBS_EVERY_MS);
    return (
        <section class="panel" aria-label="Jobs">
            <header><h2>Jobs</h2></header>
            {error && <Refused error={error} />}
            {jobs === null ? !error && <p class="quiet" role="status">Loading jobs…</p>
                : jobs.length === 0 ? <p class="quiet">No job has run in the last 30 days.</p>
                : <JobTable jobs={jobs} onCancelled={again} />}
        </section>
    );
}

function JobTable({ jobs, onCancelled }: { jobs: Job[]; onCancelled: () => void }) {
    const may = useMayAll();
    const { told, busy, attempt } = useAttempt();
    const cancel = async (job: Job) => {
        await attempt(`Cancelling ${short(job.name)}`, async () => {
            await change("POST", `${at(job.name)}/cancel`);
            return `job ${short(job.name)} is asked to end`;
        });
        onCancelled();
    };
    return <>
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of jobs"><table>
            <thead><tr><th scope="col">job</th><th scope="col">what</th><th scope="col">state</th><th scope="col">progress</th><th scope="col">result</th><th scope="col">began</th></tr></thead>
            <tbody>
                {jobs.map((job) => (
                    <tr key={job.name}>
                        <th scope="row">{short(job.name)}</th><td class="short">{job.kind.replaceAll("_", " ")}</td>
                        <td><span class={`reason ${job.state}`}>{job.state}</span></td>
                        <td class="progress">
                            <progress aria-label={`progress of ${short(job.name)}`} value={job.state === "succeeded" ? 1 : job.fraction} max={1} /> {job.state === "running" && job.stage}
                            {may && job.state === "running" && <button type="button" disabled={busy} aria-label={`Cancel job ${short(job.name)}`} onClick={() => void cancel(job)}>Cancel</button>}
                        </td>
                        <td>{job.error?.message ?? job.result ?? ""}</td><td class="short">{moment(job.create_time_ns)}</td>
                    </tr>
                ))}
            </tbody>
        </table></div>
        <Outcome told={told} />
    </>;
}

function Models() {
    const may = useMayAll();
    const [changes, setChanges] = useState(0);
    const [leaving, setLeaving] = useState<Model | null>(null);
    const [naming, setNaming] = useState<Model | null>(null);
    const asked = useAsked((signal) => all<"models", Model>("/v1/models", "models", signal, 200), [changes]);
    const changed = () => {
        setLeaving(null);
        setNaming(null);
        setChanges((count) => count + 1);
    };
    return (
        <section class="panel" aria-label="Models">
            <header><h2>Models</h2></header>
            <Shown asked={asked} what="models">
                {(models) => models.length === 0
                    ? <p class="quiet">There is no model yet: <code>waypost model train</code> makes one of images, and a file of one can be brought here.</p>
                    : <ModelTable models={models} onDelete={may ? setLeaving : null} onName={may ? setNaming : null} />}
            </Shown>
            {may && <Bringing onCame={changed} />}
            {naming && <Naming model={naming} onClose={() => setNaming(null)} onDone={changed} />}
            {leaving && (
                <Deletion
                    what="the model" name={leaving.display_name || short(leaving.name).slice(0, 12)} act={() => change("DELETE", at(leaving.name))}
                    loss="It cannot be trained again to the same bytes without its images. A model that a map uses is not deleted."
                    onClose={() => setLeaving(null)} onDone={changed}
                />
            )}
        </section>
    );
}

interface ModelTableProps {
    models: Model[];
    onDelete: ((model: Model) => void) | null;
    onName: ((model: Model) => void) | null;
}

function ModelTable({ models, onDelete, onName }: ModelTableProps) {
    const { told, busy, attempt } = useAttempt();
    const take = (model: Model) => attempt("Fetching it", async () => {
        await download(`${at(model.name)}/export`, `${short(model.name).slice(0, 12)}.waypost`);
        return "among your downloads";
    });
    const named = (model: Model) => model.display_name || short(model.name).slice(0, 12);
    return <>
        <div class="wide tall roomy" tabIndex={0} role="group" aria-label="Table of models"><table>
            <thead><tr><th scope="col">model</th><th scope="col">name</th><th scope="col">features</th><th scope="col">words</th><th scope="col">samples</th><th scope="col">size</th><th scope="col">since</th><th scope="col"><span class="unseen">what to do</span></th></tr></thead>
            <tbody>
                {models.map((model) => (
                    <tr key={model.name}>
                        <th scope="row"><code title={model.name}>{short(model.name).slice(0, 12)}</code></th><td>{model.display_name}</td>
                        <td>{model.extractor}</td><td>{count(model.words)}</td><td>{count(model.samples)}</td>
                        <td>{bytes(model.size_bytes)}</td><td>{moment(model.create_time_ns)}</td>
                        <td class="do">
                            <button type="button" disabled={busy} aria-label={`Export the model ${named(model)}`} onClick={() => void take(model)}>Export</button>
                            {onName && <button type="button" aria-label={`Rename the model ${named(model)}`} onClick={() => onName(model)}>Rename</button>}
                            {onDelete && <button type="button" aria-label={`Delete the model ${named(model)}`} onClick={() => onDelete(model)}>Delete</button>}
                        </td>
                    </tr>
                ))}
            </tbody>
        </table></div>
        <Outcome told={told} />
    </>;
}

function Naming({ model, onClose, onDone }: { model: Model; onClose: () => void; onDone: () => void }) {
    const [name, setName] = useState(model.display_name);
    const { told, busy, attempt } = useAttempt();
    const rename = async () => {
        if (await attempt("Renaming it", async () => {
            await change<Model>("PUT", `${at(model.name)}/display-name`, { display_name: name });
            return "renamed";
        })) onDone();
    };
    return (
        <Dialog title={`Rename the model ${short(model.name).slice(0, 12)}`} onClose={onClose}>
            <form onSubmit={(event) => {
                event.preventDefault();
                void rename();
            }}>
                <label>Name <input value={name} autoComplete="off" autoFocus required onInput={(event) => setName(event.currentTarget.value)} /></label>
                <p class="actions"><button type="submit" class="main" disabled={busy}>Rename it</button></p>
                <Outcome told={told} />
            </form>
        </Dialog>
    );
}

function Bringing({ onCame }: { onCame: () => void }) {
    const [name, setName] = useState("");
    const [file, setFile] = useState<File | null>(null);
    const { told, busy, attempt } = useAttempt();
    const bring = async () => {
        if (file && await attempt("Sending it", async () => {
            const model = await send<Model>(`/v1/models?display_name=${encodeURIComponent(name)}`, file);
            return `model ${short(model.name).slice(0, 12)} is there`;
        })) onCame();
    };
    return <>
        <form class="making" onSubmit={(event) => {
            event.preventDefault();
            void bring();
        }}>
            <label>Model file <input type="file" accept=".waypost" required onChange={(event) => setFile(event.currentTarget.files?.[0] ?? null)} /></label>
            <label>Name <input value={name} autoComplete="off" placeholder="site" onInput={(event) => setName(event.currentTarget.value)} /></label>
            <button type="submit" disabled={busy || !file}>Import a model</button>
        </form>
        <Outcome told={told} />
    </>;
}
