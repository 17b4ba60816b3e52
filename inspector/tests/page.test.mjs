// The page in a real browser, on what the demo made, against what REST says. One after the other: the first waits for
// the demo, and after the last its server asks for tokens.
import "./maps.mjs";
import "./pictures.mjs";
import "./correcting.mjs";
import "./matrix.mjs";
import "./large.mjs";
import "./operations.mjs";
import "./merging.mjs";
import "./live.mjs";
import "./numbers.mjs";
import "./tokens.mjs";
