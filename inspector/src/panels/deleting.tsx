// A session leaves its map, as a job: by who types its name.
import { useState } from "preact/hooks";
import { at, change, short, type Job, type Session } from "../rest";
import { Deletion, ended, plural, useMayAll } from "../parts";

export function DeleteSession({ session, onDeleted }: { session: Session; onDeleted: () => void }) {
    const may = useMayAll();
    const [asking, setAsking] = useState(false);
    if (!may) return null;
    return <>
        <button type="button" onClick={() => setAsking(true)}>Delete the session</button>
        {asking && (
            <Deletion
                what="the session" name={short(session.name)} act={async (tell) => ended(await change<Job>("DELETE", at(session.name)), tell)}
                loss={`Its ${plural(session.frames, "frame")} are lost for good, and the map is as if the robot had not been there. Places may then have other numbers.`}
                onClose={() => setAsking(false)} onDone={() => {
                    setAsking(false);
                    onDeleted();
                }}
            />
        )}
    </>;
}
