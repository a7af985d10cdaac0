#include "kept_settings.h"

#include <avr/eeprom.h>

static void *const place = (void *)KEPT_AT;

struct kept_settings load_settings(void) {
    struct kept_settings kept;
    eeprom_read_block(&kept, place, sizeof kept);
    if (kept.check != check_of(&kept) || kept.gap_mv < LOWEST_GAP_MV || kept.gap_mv > HIGHEST_GAP_MV) {
        kept.board_id = DEFAULT_BOARD_ID;
        kept.gap_mv = DEFAULT_GAP_MV;
    }
    return kept;
}

void keep_settings(struct kept_settings *settings) {
    settings->check = check_of(settings);
    eeprom_update_block(settings, place, sizeof *settings);
}
