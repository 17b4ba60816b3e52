// What the server works with and on: models and jobs.
import { all, short, type Schemas } from "../rest";
import { bytes, count, moment, Shown, useAsked } from "../parts";

export function Operations() {
    const models = useAsked((signal) => all<"models", Schemas["Model"]>("/v1/models", "models", signal, 200), []);
    const jobs = useAsked((signal) => all<"jobs", Schemas["Job"]>("/v1/jobs", "jobs", signal, 200), []);
    return (
        <main class="operations" id="content">
            <h1>Operations</h1>
            <section class="panel" aria-label="Jobs">
                <header><h2>Jobs</h2></header>
                <Shown asked={jobs} what="jobs">{(jobs) => <Jobs jobs={jobs} />}</Shown>
            </section>
            <section class="panel" aria-label="Models">
                <header><h2>Models</h2></header>
                <Shown asked={models} what="models">{(models) => <Models models={models} />}</Shown>
            </section>
        </main>
    );
}

function Jobs({ jobs }: { jobs: Schemas["Job"][] }) {
    if (jobs.length === 0) return <p class="quiet">No job has run in the last 30 days.</p>;
    return (
        <div class="wide" tabIndex={0} role="group" aria-label="Table of jobs"><table>
            <thead><tr><th scope="col">job</th><th scope="col">what</th><th scope="col">state</th><th scope="col">progress</th><th scope="col">result</th><th scope="col">began</th></tr></thead>
            <tbody>
                {jobs.map((job) => (
                    <tr key={job.name}>
                        <th scope="row">{short(job.name)}</th><td>{job.kind.replaceAll("_", " ")}</td>
                        <td><span class={`reason ${job.state}`}>{job.state}</span></td>
                        <td><progress aria-label={`progress of ${short(job.name)}`} value={job.fraction} max={1} /> {job.stage}</td>
                        <td>{job.error?.message ?? job.result ?? ""}</td><td>{moment(job.create_time_ns)}</td>
                    </tr>
                ))}
            </tbody>
        </table></div>
    );
}

function Models({ models }: { models: Schemas["Model"][] }) {
    if (models.length === 0) return <p class="quiet">There is no model yet: <code>waypost model import FILE</code> brings one.</p>;
    return (
        <div class="wide" tabIndex={0} role="group" aria-label="Table of models"><table>
            <thead><tr><th scope="col">model</th><th scope="col">name</th><th scope="col">features</th><th scope="col">words</th><th scope="col">samples</th><th scope="col">size</th><th scope="col">since</th></tr></thead>
            <tbody>
                {models.map((model) => (
                    <tr key={model.name}>
                        <th scope="row"><code title={model.name}>{short(model.name).slice(0, 12)}</code></th><td>{model.display_name}</td>
                        <td>{model.extractor}</td><td>{count(model.words)}</td><td>{count(model.samples)}</td>
                        <td>{bytes(model.size_bytes)}</td><td>{moment(model.create_time_ns)}</td>
                    </tr>
                ))}
            </tbody>
        </table></div>
    );
}
