#pragma once

#include <memory>
#include <string>

namespace apache::thrift {
class TProcessorFactory;
}

namespace iotcloud::master {

class Master;

/// Serves TMasterAPIService from a master, with one handler for each connection.
/// \param token what authenticate() must bring before anything else is answered; empty: nothing is asked for.
/// \param master outlives all connections.
std::shared_ptr<apache::thrift::TProcessorFactory> serve_api(Master& master, std::string token);

}  // namespace iotcloud::master
