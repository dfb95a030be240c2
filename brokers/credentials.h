#pragma once

#include <string>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

struct Credentials {
  std::string user;  ///< empty: none given
  std::string password;
};

/// Who connects to this URL: BrokerOptions' user and password go before the URL's. Read anew at each call, so that a
/// password that changes is taken at the next connection.
/// \throws config::Error naming the file or variable that is not there; never showing what is in it.
Credentials credentials_for(const BrokerOptions& options, const BrokerUrl& url);

}  // namespace iotcloud::brokers
