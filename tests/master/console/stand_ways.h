#pragma once

#include <string>

#include <nlohmann/json_fwd.hpp>

/// What driver hosts and a worker of the made-up fleet tell of the way of messages.
namespace iotcloud::master {

/// The answer to a look with every_ms: the message of which the worker's page told last. \param incoming of a channel
/// to the device. \param hostile a text that a hostile driver writes
nlohmann::json timed_look(bool incoming, const std::string& hostile);
/// The page /trace of a worker: each call tells of one more message. \param near its clock is the driver host's
nlohmann::json trace_page(bool near, const std::string& hostile);
/// The page /units of a worker.
nlohmann::json units_page(const std::string& hostile);

}  // namespace iotcloud::master
