// Builds the page into ../static: index.html, assets/app.js with its chunks, assets/app.css, assets/licenses.txt.
// `--tests` bundles the unit tests into build/tests instead.
import { cpSync, existsSync, mkdirSync, readFileSync, readdirSync, renameSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { gzipSync } from "node:zlib";
import { build } from "esbuild";
import subsetFont from "subset-font";

const here = dirname(fileURLToPath(import.meta.url));
const common = {
  absWorkingDir: here,
  bundle: true,
  format: "esm",
  target: ["es2022"],
  jsx: "automatic",
  jsxImportSource: "preact",
  legalComments: "none",
  charset: "utf8",
  logLevel: "warning",
};

/** Of the font only what the page can show: the characters of western languages, its weights, and its figures of one
 *  width. The package's file is 48 kB, a third of the page; most of it is alternates that nothing here turns on. */
const FONT = {
  targetFormat: "woff2",
  keepFeatures: ["ccmp", "kern", "mark", "tnum"],
  variationAxes: { wght: { min: 400, max: 750 } },
};
const FONT_CHARACTERS = [[0x20, 0x7e], [0xa0, 0xff], [0x131, 0x131], [0x152, 0x153], [0x2010, 0x203a], [0x2190, 0x2193], [0x2212, 0x2212]];

const subsetFonts = {
  name: "subset fonts",
  setup(builder) {
    builder.onLoad({ filter: /\.woff2$/ }, async ({ path }) => {
      const text = FONT_CHARACTERS.flatMap(([from, to]) => Array.from({ length: to - from + 1 }, (_, i) => String.fromCodePoint(from + i)));
      return { contents: await subsetFont(readFileSync(path), text.join(""), FONT), loader: "file" };
    });
  },
};

/** The names of the packages whose code or files are in the bundle. */
function packagesOf(metafile) {
  const found = new Set();
  for (const input of Object.keys(metafile.inputs)) {
    const match = /node_modules\/((?:@[^/]+\/)?[^/]+)\//.exec(input);
    if (match) found.add(match[1]);
  }
  return [...found].sort();
}

function licences(names) {
  const parts = ["The page contains the following packages, each under the licence below.\n"];
  for (const name of names) {
    const folder = join(here, "node_modules", name);
    const info = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
    const file = readdirSync(folder).find((entry) => /^licen[cs]e/i.test(entry));
    if (file === undefined) throw new Error(`${name} has no licence file: it cannot be shipped`);
    const rule = "-".repeat(78);
    parts.push(`${rule}\n${name} ${info.version} (${info.license})\n${rule}\n\n${readFileSync(join(folder, file), "utf8").trim()}\n`);
  }
  return parts.join("\n");
}

async function page() {
  const shown = resolve(here, "../static");
  const out = `${shown}.new`; // a page that is being served is replaced in one piece, when it is whole
  rmSync(out, { recursive: true, force: true });
  mkdirSync(join(out, "assets"), { recursive: true });
  const result = await build({
    ...common,
    entryPoints: { app: "src/main.ts" },
    outdir: join(out, "assets"),
    splitting: true,
    chunkNames: "[name]-[hash]",
    minify: true,
    metafile: true,
    define: { "process.env.NODE_ENV": '"production"' },
  });
  const styles = await build({
    ...common,
    entryPoints: { app: "src/styles/app.css" },
    outdir: join(out, "assets"),
    minify: true,
    metafile: true,
    plugins: [subsetFonts],
    assetNames: "[name]",
  });
  const names = new Set([...packagesOf(result.metafile), ...packagesOf(styles.metafile)]);
  writeFileSync(join(out, "assets", "licenses.txt"), licences([...names].sort()));
  cpSync(join(here, "public"), out, { recursive: true });
  rmSync(`${shown}.old`, { recursive: true, force: true });
  if (existsSync(shown)) renameSync(shown, `${shown}.old`);
  renameSync(out, shown);
  rmSync(`${shown}.old`, { recursive: true, force: true });
  let total = 0;
  for (const name of readdirSync(join(shown, "assets"))) {
    if (/\.(js|css)$/.test(name)) total += gzipSync(readFileSync(join(shown, "assets", name)), { level: 9 }).length;
  }
  console.log(`page: ${(total / 1000).toFixed(1)} kB of scripts and styles, compressed`);
}

async function tests() {
  const out = join(here, "build", "tests");
  rmSync(out, { recursive: true, force: true });
  const files = readdirSync(join(here, "test")).filter((name) => /\.test\.tsx?$/.test(name));
  await build({
    ...common,
    entryPoints: files.map((name) => join("test", name)),
    outdir: out,
    platform: "node",
    packages: "external",
    sourcemap: "inline",
  });
}

await (process.argv.includes("--tests") ? tests() : page());
