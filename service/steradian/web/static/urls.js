// @ts-check
// URLs of the service below the path of a reverse proxy, derived from the URL of this file.

const [ORIGIN, ROOT_PATH] = /^(https?:\/\/[^/]+)(.*)\/static\/[^/]*$/.exec(import.meta.url)?.slice(1) ?? ["", ""];

/**
 * Return the URL of a path of this service: `/scans` is `/steradian/scans` below that proxy path. Paths that already
 * start with the proxy path, such as links in responses, are unchanged.
 * @param {string} path
 */
export function urlOf(path) {
  return !path.startsWith("/") || (ROOT_PATH && path.startsWith(`${ROOT_PATH}/`)) ? path : ROOT_PATH + path;
}

/** URL of the service, for commands to copy. */
export const SERVICE_URL = ORIGIN + ROOT_PATH;
