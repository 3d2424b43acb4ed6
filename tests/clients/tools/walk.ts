// Mask, plan, scan, reconstruction, slice with openapi-fetch and the types of openapi-typescript: walk.ts ADDRESS KEY.

import createClient from "openapi-fetch";
import type { components, paths } from "./schema.js";

declare const process: { argv: string[] };
const [address, key] = process.argv.slice(2);
const client = createClient<paths>({ baseUrl: address, headers: { Authorization: `Bearer ${key}` } });
const Prefer = "wait=100";

function expect<T>(answer: { data?: T; error?: { detail: string } }): T {
  if (answer.data === undefined) throw new Error(answer.error?.detail ?? "no answer");
  return answer.data;
}

const mask = expect(await client.POST("/api/v1/masks", {
  body: { arrangement: "equi-steradian", aperture: 13.56e-3, depth: 3.6e-3, count: 60 },
}));
const plan = expect(await client.POST("/api/v1/plans", {
  body: { mask_id: mask.id, samples: 512, pulse_rate: 1000 },
}));
let scan: components["schemas"]["ScanView"] = expect(await client.POST("/api/v1/scans", {
  body: { plan_id: plan.id },
  params: { header: { "Idempotency-Key": crypto.randomUUID(), Prefer } },
}));
while (scan.ended === null) {
  scan = expect(await client.GET("/api/v1/scans/{scan_id}", {
    params: { path: { scan_id: scan.id }, header: { Prefer } },
  }));
}
if (scan.state !== "complete") throw new Error(scan.state);

let job: components["schemas"]["ReconstructionView"] = expect(await client.POST("/api/v1/reconstructions", {
  body: { scan_id: scan.id, parameters: { method: "nedner", modes: 32, depth_range: [1e-3, 5e-3] } },
  params: { header: { Prefer } },
}));
while (job.ended === null) {
  job = expect(await client.GET("/api/v1/reconstructions/{reconstruction_id}", {
    params: { path: { reconstruction_id: job.id }, header: { Prefer } },
  }));
}
if (job.report === null) throw new Error(job.error?.detail ?? job.state);
const volume = expect(await client.GET("/api/v1/reconstructions/{reconstruction_id}/volume", {
  params: { path: { reconstruction_id: job.id }, query: { slice: ":,16,:" } },
  headers: { Accept: "application/json" },
}));
if (typeof volume === "string") throw new Error("no JSON came");
const picture = expect(await client.GET("/api/v1/reconstructions/{reconstruction_id}/mip", {
  params: { path: { reconstruction_id: job.id }, query: { axis: "z" } },
  parseAs: "arrayBuffer",
}));
const refused = await client.POST("/api/v1/masks", {
  body: { arrangement: "equi-steradian", aperture: -1, depth: 3.6e-3, count: 60 },
});
if (refused.error?.status !== 422) throw new Error("a wrong mask was taken");

console.log(JSON.stringify({
  job: job.id, shape: job.report.shape, slice: volume.values, picture: picture.byteLength,
}));
