#pragma once

#include <string>

#include "iotcloud/brokers/broker_url.h"
#include <iotcloud/brokers/broker.h>

namespace iotcloud::brokers {

struct Credentials {
  std::string user;  ///< empty: none given
  std::string password;
};

/// The user and password for this URL: BrokerOptions' override the URL's. Read anew at each call, so that the next
/// connection uses a changed password.
/// \throws config::Error naming the missing file or variable, never its contents.
Credentials credentials_for(const BrokerOptions& options, const BrokerUrl& url);

}  // namespace iotcloud::brokers
