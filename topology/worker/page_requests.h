#pragma once

#include <map>
#include <string>

#include <iotcloud/topology/worker/worker.h>

/// What pages of a worker answer to requests over HTTP, and to those of a console in the same process.
namespace iotcloud::topology {

using PageQuery = std::map<std::string, std::string>;

/// One poll of a tap (TapDesk): `id`; `component`, `stream`, `rate` (samples of a task in a second) and `bytes` (of
/// each payload, 262 144 at most) in the first poll; `end` in the last one. \return JSON. \throws std::invalid_argument
/// that says what is wrong with the request; config::Error before Worker::start()
std::string tap_page(Worker& worker, const PageQuery& query);

/// One poll for the ways of an instance's messages (MessageTraces): `id`, `driver` (an instance), `every_ms`; `end` in
/// the last one. \return {"topology", "worker", "host", "clock", "wall_us", "missed", "ways": [{"driver", "gateway",
/// "time_ms", "topic", "spout", "came_us", "taken_us", "done_us", "outcome", "tries", "more_steps", "steps":
/// [{"component", "task", "from", "stream", "emitted_us", "begin_us", "end_us", "settled_us", "acked"}]}]}. Times are
/// microseconds of the clock that `clock` names (config::system_clock_name()), 0: not yet; `wall_us` more are
/// microseconds since 1970, as this machine's clock has it. \throws as tap_page()
std::string trace_page(Worker& worker, const PageQuery& query);

/// Which units of placement the worker's spouts read, up to a second old. \return {"topology", "worker", "spouts":
/// [{"component", "units": [{"unit", "task"}], "more"}]}; `task` is the index of the task that reads it, and `more`
/// units are not listed. \throws config::Error before Worker::start()
std::string units_page(const Worker& worker);

}  // namespace iotcloud::topology
