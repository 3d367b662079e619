/* Holds host/src/hal/ffi.rs and host/src/hal.rs against the real headers. Compiling is the test:
 *   gcc -Wall -Werror -I/usr/include/linuxcnc -c host/abi/abi.c -o /dev/null
 * Needs Debian's linuxcnc-uspace-dev; without the package the check is skipped. */
#define RTAPI 1
#include <rtapi.h>
#include <hal.h>

/* hal.rs: Type, Direction, Level */
_Static_assert(HAL_BIT == 1 && HAL_FLOAT == 2 && HAL_S32 == 3 && HAL_U32 == 4, "hal_type_t");
_Static_assert(HAL_IN == 16 && HAL_OUT == 32 && HAL_IO == 48 && HAL_RO == 64 && HAL_RW == 192, "directions");
_Static_assert(RTAPI_MSG_ERR == 1 && RTAPI_MSG_INFO == 3, "msg_level_t");
/* they are passed as int */
_Static_assert(sizeof(hal_type_t) == 4 && sizeof(hal_pin_dir_t) == 4 && sizeof(hal_param_dir_t) == 4, "enum size");
/* hal.rs: Value::Raw */
_Static_assert(sizeof(hal_bit_t) == 1 && sizeof(hal_s32_t) == 4 && sizeof(hal_u32_t) == 4 && sizeof(hal_float_t) == 8,
               "values");
/* hal/ffi.rs */
_Static_assert(HAL_NAME_LEN >= 47, "HAL_NAME_LEN");

int (*init)(const char *) = hal_init;
int (*exit_)(int) = hal_exit;
int (*ready)(int) = hal_ready;
void *(*malloc_)(long) = hal_malloc;
int (*pin_new)(const char *, hal_type_t, hal_pin_dir_t, void **, int) = hal_pin_new;
int (*param_new)(const char *, hal_type_t, hal_param_dir_t, void *, int) = hal_param_new;
int (*pin_alias)(const char *, const char *) = hal_pin_alias;
int (*param_alias)(const char *, const char *) = hal_param_alias;
int (*export_funct)(const char *, void (*)(void *, long), void *, int, int, int) = hal_export_funct;
void (*print_msg)(msg_level_t, const char *, ...) = rtapi_print_msg;
