// What a drawing shows, and how smoothly: for tests and figures.

/** Whether more than the background was drawn. */
export const colours = (canvas) => canvas.evaluate((canvas) => {
    const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
    return new Set(new Uint32Array(data.buffer)).size;
});

/** Frames a second while the drawing is dragged for two seconds. */
export async function panned(page, canvas) {
    const box = await canvas.boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    await page.mouse.down();
    await page.evaluate(() => {
        globalThis.frames_ms = [];
        const next = (now) => {
            globalThis.frames_ms.push(now);
            globalThis.counting = requestAnimationFrame(next);
        };
        requestAnimationFrame(next);
    });
    for (const end = Date.now() + 2000; Date.now() < end;) {
        const along = 60 * Math.sin(Date.now() / 300);
        await page.mouse.move(x + along, y + along / 2);
    }
    const frames = await page.evaluate(() => {
        cancelAnimationFrame(globalThis.counting);
        return globalThis.frames_ms;
    });
    await page.mouse.up();
    return (1000 * (frames.length - 1)) / (frames.at(-1) - frames[0]);
}
