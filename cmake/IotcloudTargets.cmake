# One function for each kind of target. `USES` names rooms (tests/house checks the includes against it); `LIBRARIES` and
# `PRIVATE_LIBRARIES` name third-party targets.
include(IotcloudPrecompiled)

add_custom_target(generated)  # what Thrift writes: tools that read sources need it
add_custom_target(programs)  # all installed programs and plugins: tests of several processes need them

# Several sources of a target are compiled as one translation unit (IOTCLOUD_UNITY), because a compiler mostly reads
# included headers. A source whose headers clash with those of its neighbours sets SKIP_UNITY_BUILD_INCLUSION.
function(_iotcloud_unity target most)
  set_target_properties(${target} PROPERTIES UNITY_BUILD ${IOTCLOUD_UNITY} UNITY_BUILD_BATCH_SIZE ${most})
endfunction()

# Code whose speed users notice is optimized further than the rest (IotcloudSettings.cmake).
function(_iotcloud_hot target)
  target_compile_options(${target} PRIVATE $<$<CONFIG:Release>:-O3>)
endfunction()

# A few sources that compute over whole frames: at -O0 tests would spend minutes in them. Headers precompiled at -O0 do not
# serve them.
function(_iotcloud_computes target)
  if(IOTCLOUD_SANITIZE)
    target_compile_options(${target} PRIVATE -O2)
    set_target_properties(${target} PROPERTIES DISABLE_PRECOMPILE_HEADERS ON)
  endif()
endfunction()

function(_iotcloud_setup target)
  cmake_parse_arguments(arg "" "" "USES;LIBRARIES;PRIVATE_LIBRARIES" ${ARGN})
  list(TRANSFORM arg_USES PREPEND iotcloud_)
  target_link_libraries(${target} PUBLIC ${arg_USES} ${arg_LIBRARIES} PRIVATE ${arg_PRIVATE_LIBRARIES})
  target_link_libraries(${target} PRIVATE $<BUILD_INTERFACE:iotcloud_warnings>)
  target_include_directories(${target} PUBLIC $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/include>)
  target_include_directories(${target} SYSTEM PRIVATE ${IOTCLOUD_GENERATED_DIR})
endfunction()

# A room, or a part of one: a static library `iotcloud_<name>`, exported as `iotcloud::<name>`.
#   iotcloud_room(NAME brokers [HOT] [COMPUTES] SOURCES a.cc HEADERS a.h USES config LIBRARIES ... PRIVATE_LIBRARIES ...
#                 [INSTALL])
# HEADERS are the public headers. INSTALL: authors of drivers, spouts and bolts link it, or their tests do. HOT: messages pass through it.
# COMPUTES: sanitized builds optimize it too.
function(iotcloud_room)
  cmake_parse_arguments(arg "HOT;COMPUTES;INSTALL" "NAME" "SOURCES;HEADERS;USES;LIBRARIES;PRIVATE_LIBRARIES" ${ARGN})
  set(target iotcloud_${arg_NAME})
  if(arg_SOURCES)
    add_library(${target} STATIC ${arg_SOURCES})
    _iotcloud_setup(${target} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES} PRIVATE_LIBRARIES ${arg_PRIVATE_LIBRARIES})
    _iotcloud_unity(${target} 12)
    if(arg_HOT AND CMAKE_BUILD_TYPE STREQUAL Release)
      _iotcloud_hot(${target})
      iotcloud_precompiled(${target} hot)
    else()
      iotcloud_precompiled(${target} rooms)
    endif()
    if(arg_COMPUTES)
      _iotcloud_computes(${target})
    endif()
    set(scope PUBLIC)
  else()
    add_library(${target} INTERFACE)
    list(TRANSFORM arg_USES PREPEND iotcloud_)
    target_link_libraries(${target} INTERFACE ${arg_USES} ${arg_LIBRARIES})
    target_include_directories(${target} INTERFACE $<BUILD_INTERFACE:${PROJECT_BINARY_DIR}/include>)
    set(scope INTERFACE)
  endif()
  add_library(iotcloud::${arg_NAME} ALIAS ${target})
  set_target_properties(${target} PROPERTIES EXPORT_NAME ${arg_NAME})
  if(arg_HEADERS)
    # Base folder and files both go through the link, so that `#include <iotcloud/...>` works in the tree and installed.
    file(RELATIVE_PATH here ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
    list(TRANSFORM arg_HEADERS PREPEND ${PROJECT_BINARY_DIR}/include/iotcloud/${here}/)
    target_sources(${target} ${scope} FILE_SET HEADERS BASE_DIRS ${PROJECT_BINARY_DIR}/include FILES ${arg_HEADERS})
    set_property(GLOBAL APPEND PROPERTY IOTCLOUD_PUBLIC_HEADERS ${arg_HEADERS})
  endif()
  if(arg_INSTALL)
    # Installed headers need C++20, and the default of another project's compiler may be older.
    target_compile_features(${target} ${scope} $<INSTALL_INTERFACE:cxx_std_20>)
    # A symbol that nothing defines is an error of the linker, not of the gateway that loads the plugin.
    target_link_options(${target} INTERFACE $<INSTALL_INTERFACE:LINKER:-z,defs>)
    set_property(GLOBAL APPEND PROPERTY IOTCLOUD_SDK_TARGETS ${target})
  endif()
endfunction()

# A program, installed to bin/. Each program is an install component of its own, so that an image can take single ones.
function(iotcloud_program)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES" ${ARGN})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  _iotcloud_unity(${arg_NAME} 12)
  set_target_properties(${arg_NAME} PROPERTIES ENABLE_EXPORTS OFF)
  add_dependencies(programs ${arg_NAME})
  install(TARGETS ${arg_NAME} RUNTIME DESTINATION bin COMPONENT ${arg_NAME})
endfunction()

# A plugin (a driver, or components of a topology): a module without "lib" in its name, in build/<preset>/plugins.
function(iotcloud_plugin)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES" ${ARGN})
  add_library(${arg_NAME} MODULE ${arg_SOURCES})
  set_target_properties(${arg_NAME} PROPERTIES PREFIX "")
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  if(NOT IOTCLOUD_SANITIZE)  # a sanitizer's own symbols are in the program
    target_link_options(${arg_NAME} PRIVATE LINKER:-z,defs)
  endif()
  _iotcloud_unity(${arg_NAME} 12)
  _iotcloud_hot(${arg_NAME})
  add_dependencies(programs ${arg_NAME})
  install(TARGETS ${arg_NAME} LIBRARY DESTINATION lib/iotcloud/plugins COMPONENT ${arg_NAME})
endfunction()

# A benchmark program; the target `benchmarks` builds them all. Only `--component NAME` installs it.
#   SMOKE: arguments of a short run, which becomes a test.
function(iotcloud_benchmark)
  cmake_parse_arguments(arg "" "NAME" "SOURCES;USES;LIBRARIES;SMOKE" ${ARGN})
  add_executable(${arg_NAME} ${arg_SOURCES})
  _iotcloud_setup(${arg_NAME} USES ${arg_USES} LIBRARIES ${arg_LIBRARIES})
  _iotcloud_unity(${arg_NAME} 12)
  _iotcloud_hot(${arg_NAME})
  add_dependencies(benchmarks ${arg_NAME})
  install(TARGETS ${arg_NAME} RUNTIME DESTINATION lib/iotcloud/bench COMPONENT ${arg_NAME} EXCLUDE_FROM_ALL)
  if(arg_SMOKE)
    iotcloud_command_test(NAME ${arg_NAME}_runs COMMAND ${arg_NAME} ${arg_SMOKE} LABELS unit NEEDS ${arg_NAME})
  endif()
endfunction()

# Compiles one Thrift file of a room into the static library `iotcloud_<name>`, private to the targets that link it.
#   iotcloud_thrift(NAME records_idl FILE records.thrift SERVICES TMasterService USES other_idl [INSTALL])
# Include its headers as "iotcloud/<room>/<file>_types.h".
function(iotcloud_thrift)
  cmake_parse_arguments(arg "INSTALL" "NAME;FILE" "SERVICES;USES" ${ARGN})
  file(RELATIVE_PATH here ${PROJECT_SOURCE_DIR} ${CMAKE_CURRENT_SOURCE_DIR})
  get_filename_component(stem ${arg_FILE} NAME_WE)
  set(out ${IOTCLOUD_GENERATED_DIR}/iotcloud/${here})
  file(MAKE_DIRECTORY ${out})
  set(outputs ${out}/${stem}_types.h ${out}/${stem}_types.cpp)
  foreach(service ${arg_SERVICES})
    list(APPEND outputs ${out}/${service}.h ${out}/${service}.cpp)
  endforeach()
  add_custom_command(
    OUTPUT ${outputs}
    COMMAND ${THRIFT_COMPILER} -gen cpp:no_skeleton,include_prefix,moveable_types -I ${PROJECT_BINARY_DIR}/include
            -out ${out} ${PROJECT_BINARY_DIR}/include/iotcloud/${here}/${arg_FILE}
    DEPENDS ${CMAKE_CURRENT_SOURCE_DIR}/${arg_FILE}
    COMMENT "Thrift ${here}/${arg_FILE}" VERBATIM)
  add_custom_target(iotcloud_${arg_NAME}_generated DEPENDS ${outputs})
  add_dependencies(generated iotcloud_${arg_NAME}_generated)
  add_library(iotcloud_${arg_NAME} STATIC ${outputs})
  add_dependencies(iotcloud_${arg_NAME} iotcloud_${arg_NAME}_generated)
  _iotcloud_unity(iotcloud_${arg_NAME} 12)
  iotcloud_precompiled(iotcloud_${arg_NAME} rooms)
  list(TRANSFORM arg_USES PREPEND iotcloud_)
  target_link_libraries(iotcloud_${arg_NAME} PUBLIC PkgConfig::thrift ${arg_USES})
  target_include_directories(iotcloud_${arg_NAME} SYSTEM PUBLIC $<BUILD_INTERFACE:${IOTCLOUD_GENERATED_DIR}>)
  if(arg_INSTALL)
    set_target_properties(iotcloud_${arg_NAME} PROPERTIES EXPORT_NAME ${arg_NAME})
    set_property(GLOBAL APPEND PROPERTY IOTCLOUD_SDK_TARGETS iotcloud_${arg_NAME})
  endif()
endfunction()
