#pragma once

#include <string>

struct ssl_ctx_st;  // OpenSSL's SSL_CTX

namespace iotcloud::brokers {

/// Makes later handshakes of this context fail if the server's certificate is on one of the lists in this file (PEM),
/// or if its authority has none there. The file is read now. \throws config::Error that names a file that cannot be
/// used.
void refuse_revoked(ssl_ctx_st* context, const std::string& file);

}  // namespace iotcloud::brokers
