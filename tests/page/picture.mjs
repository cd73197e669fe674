// Makes the picture of the README: the page while the robot rolls the pin.

import { Machine, eventually, launch, open } from "./machine.mjs";

const machine = await Machine.start(["run", "--for", "30"], "roll-pin.toml");
const browser = await launch();
const page = await open(browser, machine);
await eventually("rolling", async () => (await page.textContent("#features")).match(/strokes [2-9]/));
await page.screenshot({ path: process.argv[2] });
await browser.close();
await machine.stop();
