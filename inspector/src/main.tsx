// The page: which panel the link asks for, and the way in for those who need a token.
import { render } from "preact";
import { useEffect, useState } from "preact/hooks";
import "uplot/dist/uPlot.min.css";
import "./style.css";
import { hash, START, useLink } from "./link";
import { forgetPictures, Refused, Who } from "./parts";
import { get, short, token, whenTokenWanted, type Caller } from "./rest";
import { useSampling } from "./panels/hour";
import { MapPage } from "./panels/map";
import { Maps } from "./panels/maps";
import { MergePage } from "./panels/merge";
import { Merges } from "./panels/merges";
import { Operations } from "./panels/operations";

/** A page of a map is called by its name. */
const TITLES: Partial<Record<ReturnType<typeof useLink>[0]["page"], string>> = { maps: "Maps", merges: "Merges", operations: "Operations" };

function Inspector() {
    const [link, go] = useLink();
    const [wanted, setWanted] = useState(false);
    const [held, setHeld] = useState(token.get() !== null);
    const [entered, setEntered] = useState(0);
    const [who, setWho] = useState<Caller | null>(null);
    // A token that was made or lost in the page changes who it is, but not what is open.
    const learn = () => {
        setHeld(token.get() !== null);
        get<Caller>("/v1/whoami").then(setWho, () => setWho(null));
    };
    useEffect(learn, [entered]);
    useSampling(entered, wanted);
    const leave = () => {
        token.forget();
        forgetPictures();
        setHeld(false);
        setWho(null);
        setWanted(true);
    };
    useEffect(() => whenTokenWanted(leave), []);
    useEffect(() => {
        document.title = `${TITLES[link.page] ?? link.map} · Waypost`;
    }, [link.page, link.map]);
    const enter = () => {
        setEntered((times) => times + 1);
        setWanted(false);
    };
    const current = (page: typeof link.page) => link.page === page ? "page" as const : undefined;
    return <>
        <a class="skip" href="#content" onClick={(event) => {
            event.preventDefault();
            const content = document.querySelector<HTMLElement>("#content");
            content?.setAttribute("tabindex", "-1");
            content?.focus();
        }}>To the content</a>
        <header class="top">
            <a class="brand" href={hash(START)}><img src="/inspector/icon.svg" alt="" width={24} height={24} /> Waypost</a>
            <nav aria-label="Pages">
                <a href={hash(START)} aria-current={current("maps")}>Maps</a>
                <a href={hash({ ...START, page: "merges" })} aria-current={current("merges")}>Merges</a>
                <a href={hash({ ...START, page: "operations" })} aria-current={current("operations")}>Operations</a>
                <a href="/docs/" title={held ? "The browser asks for a password there: it is the token. Any name will do." : undefined}>API</a>
            </nav>
            {who?.token && <span class="who" title="Who the server says that you are">{short(who.token)} <span class={`reason ${who.role}`}>{who.role}</span></span>}
            {held && <button type="button" onClick={leave}>Log out</button>}
        </header>
        <Who.Provider value={who}>
            {wanted ? <Login onEnter={enter} /> : <Page key={entered} link={link} go={go} onTokens={learn} />}
        </Who.Provider>
    </>;
}

interface PageProps {
    link: ReturnType<typeof useLink>[0];
    go: ReturnType<typeof useLink>[1];
    onTokens: () => void;
}

function Page({ link, go, onTokens }: PageProps) {
    switch (link.page) {
        case "maps":
            return <Maps />;
        case "map":
            return <MapPage key={link.map} link={link} go={go} />;
        case "merges":
            return link.merge === null ? <Merges link={link} go={go} /> : <MergePage key={link.merge} number={link.merge} link={link} go={go} />;
        case "operations":
            return <Operations onTokens={onTokens} />;
    }
}

function Login({ onEnter }: { onEnter: () => void }) {
    const [secret, setSecret] = useState("");
    const [refused, setRefused] = useState<Error | null>(null);
    const [busy, setBusy] = useState(false);
    const enter = async () => {
        setBusy(true);
        setRefused(null);
        token.set(secret.trim());
        try {
            await get("/v1/maps?page_size=1");
            onEnter();
        } catch (error) {
            token.forget();
            setRefused(error as Error);
        }
        setBusy(false);
    };
    return (
        <main class="login" id="content">
            <form class="panel" onSubmit={(event) => {
                event.preventDefault();
                void enter();
            }}>
                <h1>This server asks for a token</h1>
                <p>Whoever runs the server makes one, under Operations or by <code>waypost token create NAME</code>. It is kept until this tab is closed.</p>
                <label>Token <input type="password" autoComplete="off" autoFocus required value={secret} onInput={(event) => setSecret(event.currentTarget.value)} /></label>
                <button type="submit" class="main" disabled={busy}>Log in</button>
                {refused && <Refused error={refused} />}
            </form>
        </main>
    );
}

render(<Inspector />, document.querySelector("#page")!);
