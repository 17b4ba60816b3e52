// The page: which panel the link asks for, and the way in for those who need a token.
import { render } from "preact";
import { useEffect, useState } from "preact/hooks";
import "uplot/dist/uPlot.min.css";
import "./style.css";
import { hash, START, useLink } from "./link";
import { forgetPictures, Refused } from "./parts";
import { get, token, whenTokenWanted } from "./rest";
import { MapPage } from "./panels/map";
import { Maps } from "./panels/maps";
import { Operations } from "./panels/operations";

function Inspector() {
    const [link, go] = useLink();
    const [wanted, setWanted] = useState(false);
    const [held, setHeld] = useState(token.get() !== null);
    useEffect(() => whenTokenWanted(() => {
        token.forget();
        forgetPictures();
        setHeld(false);
        setWanted(true);
    }), []);
    useEffect(() => {
        document.title = link.page === "map" ? `${link.map} · Waypost` : "Waypost";
    }, [link.page, link.map]);
    const leave = () => {
        token.forget();
        forgetPictures();
        setHeld(false);
        setWanted(true);
    };
    const enter = () => {
        setHeld(true);
        setWanted(false);
    };
    const current = (page: typeof link.page) => link.page === page ? "page" as const : undefined;
    return <>
        <a class="skip" href="#content" onClick={(event) => {
            event.preventDefault();
            document.querySelector<HTMLElement>("#content")?.scrollIntoView();
        }}>To the content</a>
        <header class="top">
            <a class="brand" href={hash(START)}><img src="/inspector/icon.svg" alt="" width={24} height={24} /> Waypost</a>
            <nav aria-label="Pages">
                <a href={hash(START)} aria-current={current("maps")}>Maps</a>
                <a href={hash({ ...START, page: "operations" })} aria-current={current("operations")}>Operations</a>
                <a href="/docs/">API</a>
            </nav>
            {held && <button type="button" onClick={leave}>Log out</button>}
        </header>
        {wanted ? <Login onEnter={enter} /> : <Page key={String(held)} link={link} go={go} />}
    </>;
}

function Page({ link, go }: { link: ReturnType<typeof useLink>[0]; go: ReturnType<typeof useLink>[1] }) {
    switch (link.page) {
        case "maps":
            return <Maps />;
        case "map":
            return <MapPage key={link.map} link={link} go={go} />;
        case "operations":
            return <Operations />;
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
                <p>Whoever runs the server makes one: <code>waypost token create NAME</code>. It is kept until this tab is closed.</p>
                <label>Token <input type="password" autoComplete="off" autoFocus required value={secret} onInput={(event) => setSecret(event.currentTarget.value)} /></label>
                <button type="submit" class="main" disabled={busy}>Log in</button>
                {refused && <Refused error={refused} />}
            </form>
        </main>
    );
}

render(<Inspector />, document.querySelector("#page")!);
