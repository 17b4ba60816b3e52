// A picture that fills the page.
import { useEffect, useRef } from "preact/hooks";
import { Picture } from "../parts";
import { at } from "../rest";

interface LargeProps {
    path: string;
    alt: string;
    /** As large as the page lets it be, or as it was drawn, to be moved about where that is larger. */
    as: "fitted" | "drawn";
    onClose: () => void;
}

export function Large({ path, alt, as, onClose }: LargeProps) {
    const dialog = useRef<HTMLDialogElement>(null);
    useEffect(() => dialog.current?.showModal(), []);
    return (
        <dialog ref={dialog} aria-label={alt} onClose={onClose}>
            <form method="dialog"><button type="submit" aria-label="Close">✕</button></form>
            {as === "fitted" ? <Picture path={path} alt={alt} /> : (
                <div class="wide roam" tabIndex={0} role="group" aria-label="Scroll to see all"><Picture path={path} alt={alt} class="sheet" /></div>
            )}
        </dialog>
    );
}

/** Where REST has a frame beside any other, each as maps/{map}/sessions/{session}/frames/{sequence}. */
export function pairPath(frame: string, beside: string): string {
    return `${at(frame)}/picture?beside_frame=${encodeURIComponent(beside)}`;
}
