// @ts-check
// Where the service is: behind a proxy perhaps below a path, which the address of this very file has in front.

const [ORIGIN, ROOT_PATH] = /^(https?:\/\/[^/]+)(.*)\/static\/[^/]*$/.exec(import.meta.url)?.slice(1) ?? ["", ""];

/**
 * The address of something of this service as a browser must ask for it: `/scans` is `/steradian/scans` below that
 * path. What has the path in front already, as links in answers may, stays as it is.
 * @param {string} path
 */
export function urlOf(path) {
  return !path.startsWith("/") || (ROOT_PATH && path.startsWith(`${ROOT_PATH}/`)) ? path : ROOT_PATH + path;
}

/** The service's own address, for commands that somebody copies. */
export const SERVICE_URL = ORIGIN + ROOT_PATH;
