#pragma once

#include <string>

#include <iotcloud/security/certificates.h>

/// Renews and revokes certificates. All functions throw Error.
namespace iotcloud::security {

inline constexpr int usual_days = 730;  ///< of a certificate

/// Makes a holder's certificate anew: name, uses and key as before, valid from now on. Readers of the file find the old
/// certificate or the new one, and both fit the key. The old one stays valid until it expires or is revoked.
void renew_certificate(const Authority& authority, const std::string& holder, int days = usual_days);

/// The authority's list of certificates that are worth nothing any more.
std::string revocations_file(const Authority& authority);
/// Makes an empty list, if there is none.
void make_revocations(const Authority& authority);
/// Puts a holder's present certificate on the list. Daemons read the list again on SIGHUP, or by themselves.
void revoke_certificate(const Authority& authority, const std::string& holder);

/// The days until the first certificate in this file expires; negative: it has expired.
double days_left(const std::string& file);

}  // namespace iotcloud::security
