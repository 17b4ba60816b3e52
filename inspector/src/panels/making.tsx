// Maps come and go: made of a model, brought as a snapshot, taken out as one, deleted.
import { useState } from "preact/hooks";
import { all, at, change, download, send, short, type Job, type Model, type Schemas, type WayMap } from "../rest";
import { bytes, Deletion, Dialog, ended, Outcome, plural, Shown, useAsked, useAttempt } from "../parts";

type Strategy = NonNullable<Schemas["MapSettingsRequest"]["navigation_strategy"]>;
type Keep = NonNullable<Schemas["MapSettingsRequest"]["keep"]>;

/** What begins a map, for those who may. */
export function NewMaps({ onChange }: { onChange: () => void }) {
    const [open, setOpen] = useState<"new" | "import" | null>(null);
    const close = () => setOpen(null);
    const done = () => {
        close();
        onChange();
    };
    return <>
        <p class="actions">
            <button type="button" class="main" onClick={() => setOpen("new")}>New map</button>
            <button type="button" onClick={() => setOpen("import")}>Import a map</button>
        </p>
        {open === "new" && <Creation onClose={close} onDone={done} />}
        {open === "import" && <Import onClose={close} onDone={done} />}
    </>;
}

interface StepProps {
    onClose: () => void;
    onDone: () => void;
}

function Creation({ onClose, onDone }: StepProps) {
    const models = useAsked((signal) => all<"models", Model>("/v1/models", "models", signal), []);
    return (
        <Dialog title="New map" onClose={onClose}>
            <Shown asked={models} what="models">
                {(models) => models.length === 0
                    ? <p>A map needs a model, and there is none yet: bring one under Operations, or train one of images with <code>waypost model train</code>.</p>
                    : <CreationForm models={models} onDone={onDone} />}
            </Shown>
        </Dialog>
    );
}

function CreationForm({ models, onDone }: { models: Model[]; onDone: () => void }) {
    const [name, setName] = useState("");
    const [model, setModel] = useState(models[0]!.name);
    const [strategy, setStrategy] = useState<Strategy>("topo_metric");
    const [keep, setKeep] = useState<Keep>("features");
    const { told, busy, attempt } = useAttempt();
    const make = async () => {
        const asked: Schemas["CreateMap"] = { map_id: name, model, settings: { navigation_strategy: strategy, keep } };
        if (await attempt("Making it", async () => {
            await change("POST", "/v1/maps", asked);
            return "made";
        })) onDone();
    };
    return (
        <form onSubmit={(event) => {
            event.preventDefault();
            void make();
        }}>
            <label>Name <input value={name} required autoFocus autoComplete="off" spellcheck={false} placeholder="office" onInput={(event) => setName(event.currentTarget.value)} /></label>
            <label>Model <select value={model} onChange={(event) => setModel(event.currentTarget.value)}>
                {models.map(({ name, display_name, extractor }) => <option key={name} value={name}>{[display_name, short(name).slice(0, 12), extractor].filter(Boolean).join(" · ")}</option>)}
            </select></label>
            <label>Robots find their way <select value={strategy} onChange={(event) => setStrategy(event.currentTarget.value as Strategy)}>
                <option value="topo_metric">by odometry and a camera that looks ahead</option><option value="appearance">by panoramas alone</option>
            </select></label>
            <label>Keep of each frame <select value={keep} onChange={(event) => setKeep(event.currentTarget.value as Keep)}>
                <option value="words">words alone</option><option value="features">features and a thumbnail</option><option value="images">also the image itself</option>
            </select></label>
            <p class="quiet small">The other settings are the usual ones; <a href="/docs/">the API</a> and <code>waypost map create</code> take all of them.</p>
            <p class="actions"><button type="submit" class="main" disabled={busy || !name}>Make the map</button></p>
            <Outcome told={told} />
        </form>
    );
}

function Import({ onClose, onDone }: StepProps) {
    const [name, setName] = useState("");
    const [file, setFile] = useState<File | null>(null);
    const { told, busy, attempt } = useAttempt();
    const choose = (chosen: File | null) => {
        setFile(chosen);
        if (chosen && !name) setName(chosen.name.replace(/\.[^.]*$/, "").toLowerCase().replace(/[^a-z0-9_-]+/g, "-").slice(0, 63));
    };
    const bring = async () => {
        if (file && await attempt(`Sending ${bytes(file.size)}`, async (tell) => {
            await ended(await send<Job>(`${at(`maps/${name}`)}/import`, file), tell);
            return "imported";
        })) onDone();
    };
    return (
        <Dialog title="Import a map" onClose={onClose}>
            <form onSubmit={(event) => {
                event.preventDefault();
                void bring();
            }}>
                <label>Snapshot <input type="file" required onChange={(event) => choose(event.currentTarget.files?.[0] ?? null)} /></label>
                <label>Name <input value={name} required autoComplete="off" spellcheck={false} onInput={(event) => setName(event.currentTarget.value)} /></label>
                <p class="actions"><button type="submit" class="main" disabled={busy || !file || !name}>Import it</button></p>
                <Outcome told={told} />
            </form>
        </Dialog>
    );
}

/** What can be done with a map as a whole, for those who may. */
export function MapActions({ map, onChange }: { map: WayMap; onChange: () => void }) {
    const [leaving, setLeaving] = useState(false);
    const { told, busy, attempt } = useAttempt();
    const name = short(map.name);
    const take = () => attempt("Fetching it", async () => {
        await download(`${at(map.name)}/export`, `${name}.waypost-map`);
        return "among your downloads";
    });
    return <>
        <p class="actions">
            <button type="button" disabled={busy} aria-label={`Export the map ${name}`} onClick={() => void take()}>Export</button>
            <button type="button" aria-label={`Delete the map ${name}`} onClick={() => setLeaving(true)}>Delete</button>
        </p>
        {told.state !== "idle" && <Outcome told={told} />}
        {leaving && (
            <Deletion
                what="the map" name={name} act={() => change("DELETE", at(map.name))}
                loss={`Its ${plural(map.places, "place")} and ${plural(map.frames, "frame")} are lost for good, unless you have exported them.`}
                onClose={() => setLeaving(false)} onDone={() => {
                    setLeaving(false);
                    onChange();
                }}
            />
        )}
    </>;
}
