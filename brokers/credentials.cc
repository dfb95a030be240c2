#include "iotcloud/brokers/credentials.h"

#include <cstdlib>
#include <fstream>

#include <iotcloud/config/error.h>

namespace iotcloud::brokers {

Credentials credentials_for(const BrokerOptions& options, const BrokerUrl& url) {
  Credentials credentials{options.user.empty() ? url.user : options.user, url.password};
  if (!options.password_file.empty()) {
    std::ifstream file(options.password_file);
    if (!std::getline(file, credentials.password)) {
      throw config::Error("the password file \"" + options.password_file +
                          "\" cannot be read or is empty; its first line must be the broker's password");
    }
    if (credentials.password.ends_with('\r')) credentials.password.pop_back();
  } else if (!options.password_variable.empty()) {
    const char* value = std::getenv(options.password_variable.c_str());
    if (value == nullptr) {
      throw config::Error("the environment variable " + options.password_variable +
                          " is not set; it must hold the broker's password");
    }
    credentials.password = value;
  }
  return credentials;
}

}  // namespace iotcloud::brokers
